"""Results as dictionaries for JSON."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, ClassVar

from burrlab.common.records import plain


class Result:
    """A dataclass that goes into JSON."""

    _derived: ClassVar[tuple[str, ...]] = ()  # properties that go there too

    def to_dict(self) -> dict[str, Any]:
        """For JSON; null for what is not finite."""
        derived = {name: getattr(self, name) for name in self._derived}
        return {name: _finite(value) for name, value in {**vars(self), **derived}.items()}


def _finite(value: Any) -> Any:
    """As `plain`, but None for what is not finite."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {name: _finite(part) for name, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(part) for part in value]
    return _finite(vars(value)) if dataclasses.is_dataclass(value) else plain(value)
