__all__ = ["Burrs", "History", "TracePlayer"]
