"""Simulated hands that probe or drill as a subject would."""

from __future__ import annotations

from burrlab._core import Burr, HandDevice

PROBING_PUSH = 1.5  # [N] at a press's height; ours
PRESSES = 0.5  # a second: ten in 20 s; ours
DRILLING_PUSH = 0.3  # [N]; ours: at 1 N the softest material would be drilled through in a second
STROKE = 5.0  # [mm] from end to end; ours
STROKES = 1.4  # full turns a second; ours
CLEARANCE = 0.5  # [mm] above the surface at the start


def probing_hand(
    burr: Burr, *, push: float = PROBING_PUSH, presses: float = PRESSES, clearance: float = CLEARANCE
) -> HandDevice:
    """A hand that presses a burr that does not turn into the bone, again and again at one place.

    Parameters
    ----------
    burr : Burr
    push : float
        At a press's height [N].
    presses : float
        A second, from the first contact on.
    clearance : float
        Of the burr above the surface z = 0 at the start [mm].

    Returns
    -------
    HandDevice

    Raises
    ------
    ValueError
        If a number is out of the range that `HandDevice` has.

    Examples
    --------
    >>> import burrlab
    >>> probing_hand(burrlab.Burr(3.0)).position
    array([0. , 0. , 3.5])
    """
    return HandDevice((0.0, 0.0, burr.radius + clearance), push=push, presses=presses, strokes=0.0, on=False)


def drilling_hand(
    burr: Burr,
    *,
    push: float = DRILLING_PUSH,
    stroke: float = STROKE,
    strokes: float = STROKES,
    clearance: float = CLEARANCE,
) -> HandDevice:
    """A hand that moves a turning burr to and fro along x with a steady push.

    Parameters
    ----------
    burr : Burr
    push : float
        [N]
    stroke : float
        From end to end [mm].
    strokes : float
        Full turns a second.
    clearance : float
        Of the burr above the surface z = 0 at the start [mm].

    Returns
    -------
    HandDevice

    Raises
    ------
    ValueError
        If a number is out of the range that `HandDevice` has.
    """
    start = (0.0, 0.0, burr.radius + clearance)
    return HandDevice(start, push=push, amplitude=0.5 * stroke, strokes=strokes)
