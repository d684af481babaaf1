"""Checks of what the public functions are given."""

from __future__ import annotations


def require_type(name: str, value: object, kind: type, example: str) -> None:
    """TypeError in one sentence unless `value` is a `kind`."""
    if not isinstance(value, kind):
        raise TypeError(f"{name} must be a {kind.__name__}, such as {example}, got {value!r}")
