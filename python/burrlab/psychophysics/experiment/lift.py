"""Waits until a hand has lifted the burr: bone that appears around a burr would throw it out."""

from __future__ import annotations

from collections.abc import Callable

from burrlab._core import Burr, Device, Material, RecordReader, VoxelBone
from burrlab.session.session import Session

_AWAY = 1e4  # [mm] from the surface to a block that nothing meets
_STEADY = 0.1  # that the burr must be lifted [s]
_PATIENCE = 0.3  # before the hand is asked to lift it [s]
_LOOK = 0.005  # [s] between two looks at the records
_MOST = 20_000  # records taken at once


def wait_until_lifted(
    device: Device,
    burr: Burr,
    *,
    on_wait: Callable[[], object],
    stop: Callable[[], bool],
    on_message: Callable[[str], object] | None = None,
) -> tuple[bool, str]:
    """Until the burr's tip has been above the plane z = 0 for 0.1 s. The force is zero meanwhile.

    Parameters
    ----------
    device : Device
        Live. Free again afterwards, but an `IgtlDevice` is closed.
    burr : Burr
    on_wait : callable
        Called once if the burr is not lifted by itself.
    stop : callable
        It is waited no more when this returns True; asked every few milliseconds.
    on_message : callable, optional
        See `burrlab.Session`.

    Returns
    -------
    lifted : bool
        False if the device came to its end or was lost, or `stop` said so.
    reason : str
        Why the waiting ended, in the session's words.

    Notes
    -----
    Bone that is there from one millisecond to the next pushes a burr of R = 3 mm that is 2 mm deep in it with 10.5 N: the
    session sends its limit of 8 N within 9 ms (docs/experiment.md).
    """
    # A session in the air: it reads the device as any other does, and its force is exactly zero.
    voxel = burr.radius / 4.0
    nothing = VoxelBone.block((voxel, voxel, voxel), voxel, origin=(0.0, 0.0, -_AWAY))
    still = Material("nothing", c_e=1.0, alpha=0.0)
    session = Session(nothing, (burr, still), device, seed=0, realtime=False, on_message=on_message)
    reader = RecordReader(session.loop)
    begun = high_since = None
    lifted = asked = False
    with session:
        while not lifted and not stop():
            if session.loop.wait(_LOOK):
                break
            records, _ = reader.take(_MOST)
            for time, z in zip(records["time"], records["burr"]["center"][:, 0, 2], strict=True):
                begun = time if begun is None else begun
                high_since = None if z < burr.radius else time if high_since is None else high_since
                lifted = lifted or (high_since is not None and time - high_since >= _STEADY)
                if not asked and high_since is None and time - begun >= _PATIENCE:
                    asked = True
                    on_wait()
        session.stop("the burr is lifted" if lifted else "no more waiting")
    return lifted, session.reason
