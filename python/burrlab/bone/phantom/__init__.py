"""Phantom: a procedural temporal bone."""
