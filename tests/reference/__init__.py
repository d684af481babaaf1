"""Slow, obvious versions of the core's algorithms, written from their definitions: the tests' oracle."""
