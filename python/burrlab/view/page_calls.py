"""What a browser may call of the page: the wishes and the controls that the page has, nothing else of trame."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

from burrlab.view.page import SPEEDS


def _number(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) <= 1e6  # NaN is none


#: What a browser may change of the page's state, and to what.
WISHES: dict[str, Callable[[Any], bool]] = {
    "wanted_s": _number, "speed": lambda value: _number(value) and value in SPEEDS,
    **dict.fromkeys(("playing", "slices", "stereo", "effects"), lambda value: type(value) is bool),
}  # fmt: skip


def restrict(handler: Any) -> None:
    """Leaves a handler of wslink no other calls than the page makes, with arguments of their kinds; others do nothing.

    trame's own would let a browser end the server, and change whatever is shown in all others, scripts as well.
    """
    calls = handler.functionMap
    core, change = calls["trame.state.update"]
    _, trigger = calls["trame.trigger"]

    def update(core: Any, changes: Any = (), *_: Any, **__: Any) -> None:
        with contextlib.suppress(TypeError, KeyError):
            change(
                core, [one for one in changes if one["key"] in WISHES and WISHES[one["key"]](one["value"])]
            )

    async def call(core: Any, name: Any = "", arguments: Any = (), *_: Any, **__: Any) -> None:
        with contextlib.suppress(TypeError, ValueError):
            if all(_number(value) or isinstance(value, bool | str) for value in arguments):
                await trigger(core, name, arguments, {})

    def none(*_: Any, **__: Any) -> None:
        """What trame's page tells of itself."""

    handler.functionMap = {
        "trame.state.get": calls["trame.state.get"],
        "trame.state.update": (core, update),
        "trame.trigger": (core, call),
        "trame.lifecycle.update": (core, none),
        "trame.error.client": (core, none),
    }
