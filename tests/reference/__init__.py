"""Slow, obvious versions of the core's algorithms, from their definitions: the tests' oracles."""
