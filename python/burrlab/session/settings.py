"""What a session is told besides its bone, burrs and devices; each object checks itself where it is made."""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from burrlab._core import Device, GuardLimits, VoxelBone
from burrlab.anatomy.watch import MARGIN, Watch, check_structure
from burrlab.common.check import check_positive, refuse, require_type, scalar, whole
from burrlab.session.devices import DeviceLimits, device_limits, limits_of_hardware
from burrlab.session.haply import HeldDevice
from burrlab.session.trace import json_text

_EXACT = 2**53  # ticks are told to replicas as float64
_RAMP = 1.0  # [s], ours
_LEAST_RATE = 20.0  # [Hz], so that a stall differs from a period


def _make_numbers(settings: object, *names: str, make: Callable[[Any, str], float] = scalar) -> None:
    """Makes Python's floats, or whole numbers, of those that were given: JSON knows no others."""
    for name in names:
        if (number := getattr(settings, name)) is not None:
            object.__setattr__(settings, name, make(number, name))


@dataclass(frozen=True, eq=False)
class StartingBone:
    """A bone as earlier ticks left it, and how a session goes on with it.

    Parameters
    ----------
    bone : VoxelBone
    tick : int
        Ticks executed earlier on it, as `load_bone` returns them.
    source : mapping, optional
        Recipe of the bone (`block_recipe`, `volume_recipe`), for replicas and the trace.
    scheme : {"layer", "cell"}
        See `BurrContact`.

    Raises
    ------
    TypeError
        If `bone` is no VoxelBone.
    ValueError
        If the tick is no whole number from 0 to below 2^53, or the source is not JSON.
    """

    bone: VoxelBone
    tick: int = 0
    source: Mapping[str, Any] | None = None
    scheme: str = "layer"

    def __post_init__(self) -> None:
        require_type("bone", self.bone, VoxelBone, "VoxelBone.block((10, 10, 5), 0.1)")
        object.__setattr__(self, "tick", whole("tick", self.tick, _EXACT, "2^53"))
        object.__setattr__(self, "source", json.loads(json_text("source", self.source)))


@dataclass(frozen=True, kw_only=True)
class Clock:
    """How a session keeps time.

    Parameters
    ----------
    rate : float
        Rate of the loop [Hz], up to 10 000; on the wall clock at least 20.
    wall_clock : bool
        Keep absolute deadlines. Otherwise periods follow one another as fast as possible, with the same
        result on every machine.
    realtime : bool
        Ask for real-time priority and locked memory.
    cpu : int, optional
        Number of the processor that the loop is kept on.
    digest_every : float
        Time between digests [s].

    Raises
    ------
    ValueError
        If a number is out of range.
    """

    rate: float = 1000.0
    wall_clock: bool = True
    realtime: bool = True
    cpu: int | None = None
    digest_every: float = 1.0

    def __post_init__(self) -> None:
        _make_numbers(self, "rate", "digest_every")
        refuse(not self.rate > 0, f"rate must be positive, got {self.rate!r}")
        refuse(
            self.wall_clock and self.rate < _LEAST_RATE,
            f"rate must be at least {_LEAST_RATE:g} Hz on the wall clock, got {self.rate!r}",
        )
        _make_numbers(self, "cpu", make=lambda number, name: whole(name, number, 2**31, "2^31"))
        refuse(not 0 < self.digest_every < 1e9, f"digest_every must be positive, got {self.digest_every!r}")


@dataclass(frozen=True, kw_only=True)
class Safety:
    """What keeps a session from hurting a hand, a device or a structure.

    Parameters
    ----------
    force_limit, slew_limit : float
        Limits of the force sent [N] and of its change [N/ms]. The defaults are ours.
    limits : str or DeviceLimits, or a list of them, optional
        Model of the devices (`device_limits`), one or one a burr, None for one without: its peak force and
        continuous force limit the force sent too, and reports compare the contact's stiffness with its. Default,
        "device": the model that the driver of a `TouchDevice`, `OmegaDevice` or `HaplyDevice` names, the least
        forces of the table if it has no such model; none for other devices.
    ramp : float, optional
        Time over which the allowed force grows from zero at the first contact, and again after a device was
        gone [s]. Default: 1 with the limits of a model, ours; otherwise none.
    coupling : float, optional
        Stiffness of a spring between device and burr [N/mm]. Default: the burr is where the device is.
    stop_at_force : float, optional
        The session ends in the tick in which a burr's force, before its limits, reaches this [N].
    stop_within : {name: float}, optional
        The session ends when a burr's surface comes so near to a watched structure [mm]. It is seen by a
        second thread, some milliseconds later; on the wall clock only.
    stop_button : int, optional
        Number of a device's button that ends the session, before the tick in which it is pressed.

    Raises
    ------
    ValueError
        If a number is out of range; by the session, if a model is unknown or a structure is not watched.
    """

    force_limit: float = 8.0
    slew_limit: float = 1.0
    limits: str | DeviceLimits | Sequence[str | DeviceLimits | None] | None = "device"
    ramp: float | None = None
    coupling: float | None = None
    stop_at_force: float | None = None
    stop_within: Mapping[str, float] = field(default_factory=dict)
    stop_button: int | None = None

    def __post_init__(self) -> None:
        _make_numbers(self, "force_limit", "slew_limit", "ramp", "coupling", "stop_at_force")
        if self.stop_at_force is not None:
            check_positive("stop_at_force", self.stop_at_force)
        _make_numbers(self, "stop_button", make=lambda number, name: whole(name, number, 8, "8"))
        require_type("stop_within", self.stop_within, Mapping, "{'facial nerve': 1.0}")
        distances = {
            name: scalar(limit, f"stop_within of {name}") for name, limit in self.stop_within.items()
        }
        object.__setattr__(self, "stop_within", distances)
        for name, limit in distances.items():
            refuse(
                not 0 <= limit <= MARGIN,
                f"stop_within of {name} must be from 0 to {MARGIN:g} mm, got {limit!r}",
            )

    def check_structures(self, watch: Watch | None, wall_clock: bool) -> None:
        """ValueError unless a session sees how near the burrs come to each structure of `stop_within`."""
        refuse(
            self.stop_within and (watch is None or not wall_clock),
            "stop_within must be used with a watch, which needs a bone with tissues, and on the wall clock",
        )
        for name in self.stop_within:
            check_structure(name, () if watch is None else watch.structures)

    def rules(self) -> list[str]:
        """Sentences on what stops the session."""
        rules = [] if self.stop_at_force is None else [f"at a force of {self.stop_at_force:g} N"]
        rules += [f"within {nearest:g} mm of {name}" for name, nearest in self.stop_within.items()]
        rules += [] if self.stop_button is None else [f"at button {self.stop_button}"]
        return [f"the session stops {rule}" for rule in rules]


class ForceLimits:
    """How a session at a rate [Hz] limits the force of its burrs.

    Attributes
    ----------
    models : list of DeviceLimits
        One a burr, empty of numbers for one without a model.
    guards : list of GuardLimits
        One a burr. Empty if nothing but `force_limit` and `slew_limit` holds.
    provenance : dict
        None for what does not hold.
    sentences : list of str
        What holds, one a burr that has a model or a ramp.
    """

    def __init__(self, safety: Safety, devices: Sequence[Device], burrs: int, rate: float) -> None:
        by_driver = safety.limits in (None, "device")  # not by the caller
        models = _models(safety.limits, devices, burrs)
        self.models = [model or DeviceLimits("no model") for model in models]
        ramps = [0.0 if by_driver and model is None else _RAMP for model in models]
        if safety.ramp is not None:
            ramps = [safety.ramp] * burrs
        self.guards: list[GuardLimits] = []
        self.sentences: list[str] = []
        self.provenance = {
            "limits": [{"model": model.model, **model.numbers()} for model in self.models]
            if any(models) or not by_driver
            else None,
            "ramp_s": (ramps if len({*ramps}) > 1 else ramps[0]) or None,
        }
        if not any(self.provenance.values()):
            return
        for burr, (model, growth) in enumerate(zip(self.models, ramps, strict=True)):
            force, lasting = (x or math.inf for x in (model.peak_force, model.continuous_force))
            self.guards.append(
                GuardLimits(
                    force=min(safety.force_limit, force), slew=safety.slew_limit, continuous=lasting,
                    window=model.window, ramp=growth,
                )
            )  # fmt: skip
            if not by_driver or models[burr] is not None or growth:
                off = "; Safety(limits=None), or --model none, turns the model's limits off"
                self.sentences.append(
                    f"burr {burr}: {_describe_guard(model, self.guards[burr], rate)}"
                    f"{off * (by_driver and models[burr] is not None)}"
                )


def _describe_guard(model: DeviceLimits, guard: GuardLimits, rate: float) -> str:
    known = guard.continuous < math.inf
    rms = f"RMS over {guard.window:g} s {guard.continuous:g} N" if known else "no continuous limit is known"
    text = (
        f"{model.model}: force at most {guard.force:g} N, its change {guard.slew:g} N/ms, {rms}, "
        f"ramp {guard.ramp:g} s"
    )
    if model.rate is not None and rate > model.rate:
        text += f"; the loop's {rate:g} Hz are more than its {model.rate:g}"
    return text


def _models(limits: Any, devices: Sequence[Device], burrs: int) -> list[DeviceLimits | None]:
    """One a burr; ValueError for an unknown model or another number of them."""
    several = isinstance(limits, Sequence) and not isinstance(limits, str)
    models = list(limits) if several else [limits] * burrs
    refuse(len(models) != burrs, f"limits must be one a burr, {burrs}, got {len(models)}")
    for burr, (model, device) in enumerate(zip(models, devices, strict=False)):
        if model == "device":
            models[burr] = limits_of_hardware(device.hardware) if isinstance(device, HeldDevice) else None
        elif isinstance(model, str):
            models[burr] = device_limits[model]
        elif model is not None:
            require_type("limits", model, DeviceLimits, "device_limits['touch']")
    return models


@dataclass(frozen=True, kw_only=True)
class Publish:
    """Where a session is published (docs/network.md). There is no authentication.

    Parameters
    ----------
    port : int, optional
        Port on which poses, forces and ticks are published over OpenIGTLink; 0 for any free one.
    vrpn : int, optional
        Port, TCP and UDP, at which VRPN's clients get each burr as the Tracker and ForceDevice
        `burrlab_burr_n`; 0 for any free one.
    host : str
        Address to listen on.
    header_version : {1, 2}
        Version of the OpenIGTLink messages sent.
    sensor : bool
        Publish the force as SENSOR messages too; 3D Slicer has none.

    Raises
    ------
    ValueError
        If a port is no whole number from 0 to below 2^16.
    """

    port: int | None = None
    vrpn: int | None = None
    host: str = "127.0.0.1"
    header_version: int = 1
    sensor: bool = True

    def __post_init__(self) -> None:
        _make_numbers(self, "port", "vrpn", make=lambda number, name: whole(name, number, 2**16, "2^16"))
