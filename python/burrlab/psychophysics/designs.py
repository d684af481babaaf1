"""Stimuli, intervals and trials; the designs same-different and ABX; the base of comparisons; orders of trials.

An order is balanced, random, and depends only on seed, subject and design. An interrupted run must resume
with the same trials. So the draws use NumPy's `SeedSequence` and `PCG64`, whose streams are the same in every
version of NumPy, and a shuffle of this module, because NumPy's may change.
"""

import hashlib
import json
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, fields, replace
from typing import Any, ClassVar, Literal, Self, TypeAlias, TypeVar

import numpy as np

from burrlab._core import Material
from burrlab.bone.materials import constants_of
from burrlab.common.check import refuse, require_type
from burrlab.psychophysics.power import design_power
from burrlab.psychophysics.rules import TaskName, one_of, whole
from burrlab.theory.continuum import Law

Mode: TypeAlias = Literal["probing", "drilling"]
Phase: TypeAlias = Literal["practice", "main", "catch"]

MODES: tuple[Mode, ...] = ("probing", "drilling")


@dataclass(frozen=True)
class Stimulus:
    """The material that an interval presents.

    Attributes
    ----------
    name : str
        As in the answer file.
    material : Material or None
        Material to render; None for a real specimen, outside the program.
    """

    name: str
    material: Material | None = None


@dataclass(frozen=True)
class Boundary:
    """Where another material begins, parallel to the surface.

    Attributes
    ----------
    depth : float
        Below the surface [mm]. A voxel belongs to the side of its centre.
    below : Material
        Of the shape and exponents of the material above.
    """

    depth: float
    below: Material


@dataclass(frozen=True)
class Interval:
    """One presentation of a stimulus.

    Attributes
    ----------
    stimulus : Stimulus
        With a boundary, the material above it.
    seed : int
        Seed of the erosion; each interval has its own.
    duration : float or None
        [s]; None if the subject ends the interval.
    boundary : Boundary or None
    """

    stimulus: Stimulus
    seed: int
    duration: float | None
    boundary: Boundary | None = None


@dataclass(frozen=True)
class Trial:
    """One question.

    Attributes
    ----------
    number : int
        In its phase, from 1.
    phase : {"practice", "main", "catch"}
        A catch trial stands among the main ones, is easy, and tells of lapses alone.
    block : int
        From 1; practice is block 0.
    trial_type : str
        Same-different: AA, AB, BA, BB. ABX: AB, BA, the order of the alternatives after the reference. Two
        intervals: RC, CR, the order of reference (R) and comparison (C), which has any boundary.
    intervals : tuple of Interval
        In the order of presentation.
    correct : str
        The correct answer.
    level : float or None
        The comparison's parameter over the reference's (constant stimuli and staircases).
    """

    number: int
    phase: Phase
    block: int
    trial_type: str
    intervals: tuple[Interval, ...]
    correct: str
    level: float | None = None


def key_of(name: str) -> str:
    """The key of a design's parameter in files; times and depths carry their unit."""
    return name + {"interval": "_s", "reference_interval": "_s", "boundary": "_mm"}.get(name, "")


def _plain(value: Any) -> Any:
    if not isinstance(value, Stimulus):
        return list(value) if isinstance(value, tuple) else value
    if (material := value.material) is None:
        return {"name": value.name, "real": True}
    return {"name": value.name, "material": material.name, **constants_of(material)}


class TaskDesign(ABC):
    """A task that one subject does in trials.

    Attributes
    ----------
    task : {"same-different", "abx", "2ifc"}
    mode : {"probing", "drilling"}
        Whether the burr is off or on.
    question : str
        Asked after the last interval.
    answers : tuple of str
        The possible responses, in the order of their keys.
    practice : int
        Trials before those that count.
    blocks : int
    boundary : (float, float) or None
        Least and greatest depth [mm] of the boundary that is asked for.
    """

    task: TaskName
    mode: Mode
    question: str
    answers: tuple[str, ...]
    practice: int
    blocks: int
    boundary: Sequence[float] | None = None
    chance: ClassVar[float] = 0.5  # proportion correct of a subject who guesses
    _kind: ClassVar[str]  # the design's name in files
    _derived: ClassVar[tuple[str, ...]] = ()  # properties that files hold besides the fields
    #: Later parameters with their defaults, which files leave out, so that orders are what they were.
    _since: ClassVar[Mapping[str, Any]] = {"catch": 0, "boundary": None, "foil": "either"}

    @abstractmethod
    def order(self, *, seed: int, subject: str) -> "Order":
        """The trials of one subject, which depend only on the design, the seed and the subject's name."""

    @abstractmethod
    def power(self, subjects: int = 1) -> str:
        """A few lines on what the design can show, before anybody takes part."""

    def to_dict(self) -> dict[str, Any]:
        """The whole design, for JSON and `design_of_dict`."""
        names = [field.name for field in fields(self)]  # type: ignore[arg-type]  # all designs are dataclasses
        return {
            "design": self._kind,
            **{
                key_of(name): _plain(getattr(self, name))
                for name in (*names, *self._derived)
                if name not in self._since or getattr(self, name) != self._since[name]
            },
        }


class Order:
    """The trials of one subject, in order; those of a staircase depend on the answers.

    Parameters
    ----------
    answers : tuple of str
        The possible responses.
    total : int
    trials : callable
        From the order to an iterator, which makes a trial after all before it are answered.

    Attributes
    ----------
    total : int
        Trials in all, practice included; for a staircase, the maximum.
    answered : list of (Trial, str)
        Answered trials with their responses, in order.
    lost : set of int
        Places in `answered` of those that do not count.
    """

    def __init__(
        self, answers: tuple[str, ...], total: int, trials: Callable[["Order"], Iterator[Trial]]
    ) -> None:
        self.total, self._answers, self._trials = total, answers, trials(self)
        self.answered: list[tuple[Trial, str]] = []
        self.lost: set[int] = set()
        self._next = next(self._trials, None)

    def next(self) -> Trial | None:
        """The next trial, which stays the same until it is answered; None at the end."""
        return self._next

    def answer(self, response: str, *, lost: bool = False) -> None:
        """Records the response to the next trial; one that is `lost` moves no staircase.

        Raises
        ------
        ValueError
            If the response is not one of the design's answers, or no trial is left.
        """
        if (trial := self._next) is None:
            raise ValueError(f"there is no trial left to answer, got {response!r}")
        one_of("response", response, self._answers)
        self.lost |= {len(self.answered)} if lost else set()
        self.answered.append((trial, response))
        self._next = next(self._trials, None)

    def counted(self) -> list[tuple[Trial, str]]:
        """Answered trials of the main phase that count."""
        return [x for i, x in enumerate(self.answered) if x[0].phase == "main" and i not in self.lost]


def seconds(name: str, value: float) -> float:
    """The time [s]; ValueError unless it is above 0."""
    refuse(not (math.isfinite(value) and value > 0), f"{name} must be a time above 0 [s], got {value}")
    return float(value)


def rendered(name: str, stimulus: Stimulus) -> Material:
    """The stimulus's material; ValueError for a real specimen."""
    require_type(name, stimulus, Stimulus, "Stimulus('bone', materials['bone'])")
    if stimulus.material is None:
        raise ValueError(
            f"{name} must have a material to be rendered, got the real specimen {stimulus.name!r}"
        )
    return stimulus.material


def checked_answers(levels: Sequence[float], correct: Sequence[bool]) -> tuple[list[float], list[bool]]:
    """Levels and answers, one of each per trial.

    Raises
    ------
    ValueError
        If their numbers differ, or a level is not above 0 or is 1.
    """
    refuse(
        len(levels) != len(correct),
        f"levels and correct must be equally many, got {len(levels)} and {len(correct)}",
    )
    return [checked_level("level", level) for level in levels], [bool(right) for right in correct]


def checked_level(name: str, level: float) -> float:
    """The ratio; ValueError unless it lies between 1e-6 and 1e6 and is not 1."""
    value = float(level)
    refuse(not 1e-6 <= value <= 1e6, f"{name} must be a ratio from 1e-6 to 1e6, got {value}")
    refuse(value == 1.0, f"{name} must differ from 1, got 1: two alike intervals have no correct answer")
    return value


T = TypeVar("T")


class Draws:
    """Random draws of one subject in one design.

    Parameters
    ----------
    seed : int
        Seed of the experiment, at least 0.
    subject : str
        Name of the subject; another name gives other draws.
    design : mapping
        The design's `to_dict`; another design gives other draws.

    Raises
    ------
    ValueError
        If the seed is negative or the name is empty.
    TypeError
        If the seed is not whole or the name is not a str.

    Examples
    --------
    >>> Draws(1, "01", {}).shuffled("abcd")
    ['d', 'a', 'b', 'c']
    """

    def __init__(self, seed: int, subject: str, design: Mapping[str, Any]) -> None:
        require_type("subject", subject, str, "'01'")
        refuse(not subject, "subject must have a name, got ''")
        seed = whole("seed", seed, at_least=0)
        # Python's own hash differs between processes.
        text = json.dumps([subject, design], sort_keys=True, allow_nan=False)
        words = np.frombuffer(hashlib.sha256(text.encode()).digest(), dtype="<u4")
        self._bits = np.random.PCG64(np.random.SeedSequence([seed, *words.tolist()]))

    def below(self, end: int) -> int:
        """A uniform whole number from 0 to end - 1; fewer than `end` of 2^64 raw draws favour some."""
        return int(self._bits.random_raw()) % end

    def shuffled(self, values: Sequence[T]) -> list[T]:
        """The values in random order, all orders equally likely (Fisher and Yates)."""
        order = list(values)
        for last in range(len(order) - 1, 0, -1):
            other = self.below(last + 1)
            order[last], order[other] = order[other], order[last]
        return order

    def interval_seed(self) -> int:
        """A 64-bit seed; of 30 000 intervals, two have one seed once in 10^10 runs."""
        return int(self._bits.random_raw())

    def balanced(self, groups: Sequence[Sequence[T]], trials: int, blocks: int = 1) -> list[list[T]]:
        """Types of trials in random order, balanced in all and as nearly as possible in each block.

        Parameters
        ----------
        groups : sequence of sequences
            The types, in groups of equal size, such as pairs that are the same and pairs that differ. In each
            block the frequencies of the groups differ by at most one.
        trials : int
            A multiple of `blocks`. If it is also a multiple of the number of types, all types are equally
            frequent.
        blocks : int, optional

        Returns
        -------
        list of lists
            One list per block. The frequencies of the types in a block are equal if its size is a multiple of
            the number of types, and differ by at most one otherwise.
        """
        # Groups take turns, so a run shorter than the cycle repeats no type and balances the groups.
        turn = [
            value
            for together in zip(*(self.shuffled(group) for group in self.shuffled(groups)), strict=True)
            for value in together
        ]
        cycles, rest = divmod(trials // blocks, len(turn))
        extras = [[turn[(block * rest + i) % len(turn)] for i in range(rest)] for block in range(blocks)]
        return [self.shuffled(turn * cycles + extra) for extra in self.shuffled(extras)]


class FixedOrder(Order):
    """An order of trials that does not depend on the answers.

    Parameters
    ----------
    trials : sequence of Trial
    answers : tuple of str
        The possible responses.
    """

    def __init__(self, trials: Sequence[Trial], answers: tuple[str, ...]) -> None:
        super().__init__(answers, len(trials), lambda order: iter(trials))
        self.trials = tuple(trials)


def _check_common(design: Any) -> None:
    """Checks the values that all designs have; the length of an interval becomes a float."""
    one_of("mode", design.mode, MODES)
    object.__setattr__(design, "interval", seconds("interval", design.interval))
    whole("practice", design.practice, at_least=0)
    whole("blocks", design.blocks, at_least=1)


class FixedDesign(TaskDesign):
    """A design whose answers do not change the order: practice, then blocks, each balanced (`Draws.balanced`)."""

    trials: int
    _types: Sequence[Sequence[Any]]  # in groups of equal size
    _trial: Callable[..., Trial]

    def order(self, *, seed: int, subject: str) -> FixedOrder:
        draws = Draws(seed, subject, self.to_dict())
        first = enumerate(draws.balanced(self._types, self.practice)[0], 1)
        trials = [self._trial(draws, kind, number, "practice", 0) for number, kind in first]
        blocks = enumerate(draws.balanced(self._types, self.trials, self.blocks), 1)
        main = enumerate(((block, kind) for block, kinds in blocks for kind in kinds), 1)
        trials += [self._trial(draws, kind, number, "main", block) for number, (block, kind) in main]
        return FixedOrder(trials, self.answers)


class Scored(FixedDesign):
    """A design whose answers make a score and do not change the order."""

    interval: float

    def _check(self, types: str, multiple: int) -> None:
        """Checks that the types can be equally frequent, that blocks have one size, and the other values."""
        whole("trials", self.trials, at_least=multiple, multiple=multiple, why=f" ({types} equally often)")
        _check_common(self)
        whole("trials", self.trials, at_least=multiple, multiple=self.blocks, why=", the number of blocks")

    def _power(self, comparison: str, subjects: int) -> str:
        return f"{comparison}\n{design_power(self.task, trials=self.trials, subjects=subjects)}"


def counterbalanced(names: Sequence[T], subject_index: int) -> list[T]:
    """The order of tasks for one subject, from Williams' Latin squares.

    With n tasks, each task has each place equally often over every n subjects. Each task also follows each
    other task equally often over every n (n even) or 2 n (n odd) subjects.

    Parameters
    ----------
    names : sequence
    subject_index : int
        Index in the protocol's list, from 0.

    Raises
    ------
    ValueError
        If there is no name, two names are equal, or the index is negative.

    References
    ----------
    E. J. Williams, Experimental designs balanced for the estimation of residual effects of treatments,
    Australian Journal of Scientific Research A 2 (1949) 149-168.

    Examples
    --------
    >>> [counterbalanced(["probing", "drilling"], subject) for subject in range(3)]
    [['probing', 'drilling'], ['drilling', 'probing'], ['probing', 'drilling']]
    """
    n = len(names)
    refuse(n == 0, "names must hold at least one, got none")
    refuse(any(name in names[:i] for i, name in enumerate(names)), f"names must differ, got {list(names)!r}")
    subject = whole("subject_index", subject_index, at_least=0)
    # 0, 1, n-1, 2, n-2, ...: each difference of neighbours occurs once
    first = [(i + 1) // 2 if i % 2 else (n - i // 2) % n for i in range(n)]
    row = [names[(place + subject) % n] for place in first]
    return row[::-1] if n % 2 and subject // n % 2 else row


#: Units of the parameters.
UNITS = {"c_e": "N/mm^2", "alpha": "1/ms"}
#: Their keys in files, with units.
PARAMETER_KEYS = {"c_e": "c_e_N_per_mm2", "alpha": "alpha_per_ms"}


@dataclass(frozen=True)
class ComparisonDesign(TaskDesign):
    """Base of the two-interval designs (2ifc) that vary c_e or alpha around a reference.

    A `level` is the comparison's parameter over the reference's. The question depends on what is varied:

    * c_e with the burr off: which material is stiffer. Only c_e is felt.
    * c_e drilled, alpha held (`hold="other"`): in which interval the burr sinks faster. The correct one has
      *less* c_e; the stiffness differs as well.
    * c_e drilled, alpha/c_e^p held (`hold="sinking speed"`): which material is stiffer. p = 4 (k + 1)/3 for
      an f with a zero of order k, 8/3 for the parabolic f. The speed is constant at forces below
      0.068 c_e R^2. For bone, a burr of 3 mm and levels of 0.75 to 1.3 it stays within 1 % at 1 N
      (mean-field); at 2 N it is 10 % faster to 17 % slower.
    * alpha drilled: in which interval the burr sinks faster. The correct one has more alpha.
    * With a `boundary`: in which interval the bone changes. There the reference lies above and the comparison
      below, so a level's side of 1 tells hard to soft from soft to hard. The other interval has one bone, the
      `foil`. docs/psychophysics.md says what is left to judge by.

    Parameters
    ----------
    reference : Stimulus
        Must have a material.
    parameter : {"c_e", "alpha"}
        The parameter to vary.
    mode : {"probing", "drilling"}
        With the burr off, or on.
    hold : {"other", "sinking speed"}
        Held constant: the other parameter, or the speed at which the burr sinks.
    interval : float
        Length of an interval [s].
    practice : int
        Trials before the first block; they do not count.
    blocks : int
        Number of blocks, with breaks between them.
    boundary : (float, float), optional
        Least and greatest depth of a boundary below the surface [mm], drawn anew in each trial. By default
        there is none. Trials whose burr did not reach it are lost: they move no staircase and do not count.
    foil : {"either", "middle"}
        The one bone without the boundary: that of either side at random; or one between them, with the
        geometric mean of their c_e and the arithmetic mean of their times for a millimetre.

    Attributes
    ----------
    question : str
    chance : float
        Proportion correct of a subject who guesses.
    """

    reference: Stimulus
    parameter: Literal["c_e", "alpha"]
    _: KW_ONLY
    mode: Mode = "probing"
    hold: Literal["other", "sinking speed"] = "other"
    interval: float = 20.0
    practice: int = 0
    blocks: int = 1
    boundary: Sequence[float] | None = None
    foil: Literal["either", "middle"] = "either"

    task = "2ifc"
    _derived: ClassVar[tuple[str, ...]] = ("held", "question", "chance")
    answers = ("first", "second")

    def __post_init__(self) -> None:
        rendered("reference", self.reference)
        one_of("parameter", self.parameter, ("c_e", "alpha"))
        _check_common(self)
        one_of("hold", self.hold, ("other", "sinking speed"))
        refuse(
            self.parameter == "alpha" and self.mode == "probing",
            "mode must be 'drilling' for parameter 'alpha', got 'probing': alpha alone changes nothing with "
            "the burr off",
        )
        refuse(
            self.hold == "sinking speed" and self.parameter == "alpha",
            "hold must be 'other' for parameter 'alpha', got 'sinking speed': alpha is felt by that speed "
            "alone",
        )
        refuse(
            self.hold == "sinking speed" and self.mode == "probing",
            "hold must be 'other' for mode 'probing', got 'sinking speed': nothing sinks with the burr off",
        )
        refuse(self._material.alpha == 0.0, "reference must have alpha above 0, got 0")
        asked = "did the burr sink faster" if self._asks_speed else "was the material stiffer"
        one_of("foil", self.foil, ("either", "middle"))
        refuse(self.boundary is None and self.foil != "either", "foil goes with boundary")
        if self.boundary is not None:
            depths, asked = tuple(map(float, self.boundary)), "did the bone change on the way"
            refuse(
                len(depths) != 2 or not 0.0 < depths[0] <= depths[1] < math.inf,
                f"boundary must be two depths above 0 [mm], the lesser first, got {list(depths)}",
            )
            refuse(self.mode == "probing", "boundary goes with mode 'drilling', got 'probing'")
            object.__setattr__(self, "boundary", depths)
        object.__setattr__(self, "question", f"In which interval {asked}, the first or the second?")

    @property
    def _material(self) -> Material:
        return rendered("reference", self.reference)

    @abstractmethod
    def extremes(self) -> Sequence[float]:
        """Levels, among them the farthest from 1 on either side."""

    @property
    def _asks_speed(self) -> bool:
        return self.mode == "drilling" and self.hold == "other"

    @property
    def held(self) -> str:
        """What reference and comparison share, in words."""
        material = self._material
        if self.parameter == "alpha":
            return f"c_e is held at {material.c_e:g} N/mm^2"
        if self.hold == "sinking speed":
            return f"alpha/c_e^{self._exponent:.3g} is held, and with it the sinking speed at forces below {6.0**-material.force_exponent:.2g} c_e R^2"
        return f"alpha is held at {material.alpha:g} /ms" + "; stiffness and sinking speed both change" * (
            self.mode == "drilling"
        )

    @property
    def what(self) -> str:
        """The varied parameter, the reference and what is held, in words."""
        within = (
            "" if self.boundary is None else "below a boundary at {:g} to {:g} mm, ".format(*self.boundary)
        )
        return f"{self.parameter} {within}around {self.reference.name} ({self.mode}; {self.held}), chance {self.chance:g}"

    @property
    def _exponent(self) -> float:
        """p of v ~ alpha/c_e^p at small forces: 2 (k + 1)/q for an f with a zero of order k at r = R."""
        return 2.0 * (self._material.shape.order + 1.0) / self._material.force_exponent

    def around(self, factors: Sequence[float], direction: Sequence[float] | None = None) -> Iterator[Self]:
        """This design around other references, for thresholds along a range.

        Parameters
        ----------
        factors : sequence of float
            c_e and alpha of a reference are this one's times factor**direction.
        direction : (float, float), optional
            Along ln c_e and along ln alpha; by default along the parameter alone.

        Raises
        ------
        ValueError
            If there are fewer than two factors, two are equal, one is not from 1e-6 to 1e6, or the direction is not
            of two numbers from -10 to 10 that move the parameter.
        """
        refuse(
            len(set(factors)) != len(factors)
            or len(factors) < 2
            or not 1e-6 <= min(factors) <= max(factors) <= 1e6,
            f"references must be two or more different factors from 1e-6 to 1e6, got {list(factors)}",
        )
        along = [float(self.parameter == name) for name in UNITS] if direction is None else list(direction)
        refuse(
            len(along) != 2 or along[self.parameter == "alpha"] == 0.0 or not max(map(abs, along)) <= 10.0,
            f"direction must be two numbers from -10 to 10, along ln c_e and ln alpha, that move {self.parameter}, got {along}",
        )
        where = f"{self.parameter} " if direction is None else ""
        for factor in factors:
            c_e, alpha = (
                getattr(self._material, name) * factor**x for name, x in zip(UNITS, along, strict=True)
            )
            source = f"times {factor:.17g}**{along} in c_e and alpha"
            moved = self._moved(f"{where}x{factor:.6g}", c_e, alpha, source)
            yield self if factor == 1.0 else replace(self, reference=moved)

    def comparison(self, level: float) -> Stimulus:
        """The stimulus of a level."""
        level = checked_level("level", level)
        source = f"with {self.parameter} times {level:.17g}; {self.held}"
        return self._moved(f"{self.parameter} x{level:.6g}", *self._constants(level), source)

    def _constants(self, level: float) -> tuple[float, float]:
        """c_e and alpha of a level."""
        c_e, alpha = self._material.c_e, self._material.alpha
        if self.parameter == "alpha":
            return c_e, alpha * level
        return c_e * level, alpha * level**self._exponent if self.hold == "sinking speed" else alpha

    def _moved(self, where: str, c_e: float, alpha: float, source: str) -> Stimulus:
        """A stimulus of the reference's law with other constants."""
        name, material = f"{self.reference.name} {where}", self._material
        return Stimulus(name, Law.of(material).material(c_e, alpha, name, f"{material.name} {source}"))

    def middle(self, level: float) -> Stimulus:
        """The foil between the bones above and below a boundary."""
        (c_e, alpha), (c_e_below, alpha_below) = self._constants(1.0), self._constants(level)
        p, mean = self._exponent, math.sqrt(c_e * c_e_below)
        slowness = 0.5 * (c_e**p / alpha + c_e_below**p / alpha_below)
        where = f"between {self.parameter} x{level:.6g}"
        return self._moved(where, mean, mean**p / slowness, f"and its level {level:.17g}, between")

    def sinks_faster(self, level: float) -> bool:
        """Whether the burr sinks faster in a level's comparison than in the reference."""
        return (level > 1.0) == (self.parameter == "alpha")

    def _trial(self, draws: Draws, kind: tuple[str, float], number: int, phase: Phase, block: int) -> Trial:
        """A trial with reference and comparison in the order of RC or CR, at a level."""
        order, level = kind
        comparison = self.comparison(level)
        plain, layered, boundary = self.reference, comparison, None
        correct = "C" if (self.sinks_faster(level) if self._asks_speed else level > 1.0) else "R"
        if self.boundary is not None:
            low, high = self.boundary
            depth = round(low + (high - low) * draws.below(1001) / 1000.0, 6)
            boundary, correct = Boundary(depth, rendered("comparison", comparison)), "C"
            plain = self.middle(level) if self.foil == "middle" else (plain, layered)[draws.below(2)]
            layered = Stimulus(f"{self.reference.name} over {comparison.name}", self._material)
        stimuli = {"R": (plain, None), "C": (layered, boundary)}
        intervals = tuple(
            Interval(stimuli[x][0], draws.interval_seed(), self.interval, stimuli[x][1]) for x in order
        )
        return Trial(number, phase, block, order, intervals, self.answers[order.index(correct)], level)


@dataclass(frozen=True)
class ABX(Scored):
    """ABX, the paper's Task 3: after the reference come a match and a foil; which one is like the reference?

    The match (A) comes first (AB) as often as second (BA), in random order. The same holds in each block of
    even size; in blocks of odd size the two frequencies differ by one.

    Parameters
    ----------
    reference : Stimulus
        Rendered, or a real specimen (no material).
    foil : Stimulus
        The wrong alternative.
    match : Stimulus, optional
        The correct alternative, by default the reference. Required for a real specimen.
    trials : int
        Even, and a multiple of `blocks`.
    interval : float
        Length of each alternative's interval [s].
    reference_interval : float, optional
        Length of the reference's interval [s]; None if the subject ends it.
    mode : {"probing", "drilling"}
        With the burr off, or on.
    practice : int
        Trials before the first block, balanced as nearly as possible; they do not count.
    blocks : int
        Number of blocks, with breaks between them.

    Attributes
    ----------
    chance : float
        Proportion correct of a subject who guesses.

    Raises
    ------
    ValueError
        If a real reference has no match, match or foil is a real specimen, both have the same name, `trials`
        is odd or not a multiple of `blocks`, a number is out of range, or the mode is unknown.
    TypeError
        If a stimulus is not a Stimulus, or a number of trials is not whole.

    Examples
    --------
    >>> from burrlab import materials
    >>> pettigrew, pvc = (Stimulus(name, materials[name]) for name in ("pettigrew", "pvc"))
    >>> task = ABX(Stimulus("real Pettigrew"), foil=pvc, match=pettigrew)
    >>> trial = task.order(seed=1, subject="01").next()
    >>> trial.trial_type, [interval.stimulus.name for interval in trial.intervals], trial.correct
    ('BA', ['real Pettigrew', 'pvc', 'pettigrew'], 'second')
    """

    reference: Stimulus
    foil: Stimulus
    _: KW_ONLY
    match: Stimulus | None = None
    trials: int = 10
    interval: float = 10.0
    reference_interval: float | None = None
    mode: Mode = "drilling"
    practice: int = 0
    blocks: int = 1

    task, _kind, _derived = "abx", "abx", ("chance",)
    _types = (("AB",), ("BA",))
    question = "After the reference came two: which of them felt like the reference?"
    answers = ("first", "second")

    def __post_init__(self) -> None:
        require_type("reference", self.reference, Stimulus, "Stimulus('real Pettigrew')")
        refuse(
            self.match is None and self.reference.material is None,
            f"match must be given, as the reference {self.reference.name!r} is a real specimen",
        )
        object.__setattr__(self, "match", self.matching)
        rendered("match", self.matching)
        rendered("foil", self.foil)
        refuse(
            self.matching.name == self.foil.name,
            f"match and foil must have different names, got {self.foil.name!r} twice",
        )
        self._check("AB and BA", 2)
        if self.reference_interval is not None:
            object.__setattr__(
                self, "reference_interval", seconds("reference_interval", self.reference_interval)
            )

    @property
    def matching(self) -> Stimulus:
        """The correct alternative."""
        return self.reference if self.match is None else self.match

    def _trial(self, draws: Draws, kind: str, number: int, phase: Phase, block: int) -> Trial:
        two = [(self.matching if letter == "A" else self.foil, self.interval) for letter in kind]
        stimuli = ((self.reference, self.reference_interval), *two)
        intervals = tuple(Interval(stimulus, draws.interval_seed(), long) for stimulus, long in stimuli)
        return Trial(number, phase, block, kind, intervals, self.answers[kind.index("A")])

    def power(self, subjects: int = 1) -> str:
        return self._power(
            f"reference {self.reference.name}, then match {self.matching.name} and foil {self.foil.name} for "
            f"{self.interval:g} s each ({self.mode}), chance {self.chance:g}",
            subjects,
        )


@dataclass(frozen=True)
class SameDifferent(Scored):
    """Same-different, the paper's Tasks 1 and 2: did two intervals hold one material or two different ones?

    AA, AB, BA and BB are equally frequent, in random order. The same holds in each block whose size is a
    multiple of four. In other blocks these frequencies differ by at most one, and so do the numbers of pairs
    that differ and that are the same.

    Parameters
    ----------
    a, b : Stimulus
        Must have materials and different names.
    trials : int
        A multiple of 4, and of `blocks`.
    interval : float
        Length of an interval [s].
    mode : {"probing", "drilling"}
        With the burr off, or on.
    practice : int
        Trials before the first block, balanced as nearly as possible; they do not count.
    blocks : int
        Number of blocks, with breaks between them.

    Raises
    ------
    ValueError
        If a or b is a real specimen, both have the same name, `trials` is not a multiple of 4 and of
        `blocks`, a number is out of range, or the mode is unknown.
    TypeError
        If a or b is not a Stimulus, or a number of trials is not whole.

    Examples
    --------
    >>> from burrlab import materials
    >>> bone, pvc = (Stimulus(name, materials[name]) for name in ("bone", "pvc"))
    >>> order = SameDifferent(bone, pvc).order(seed=1, subject="01")
    >>> [trial.trial_type for trial in order.trials]
    ['BA', 'BA', 'AB', 'BB', 'AA', 'AB', 'BA', 'AA', 'BB', 'AA', 'AB', 'BB']
    """

    a: Stimulus
    b: Stimulus
    _: KW_ONLY
    trials: int = 12
    interval: float = 20.0
    mode: Mode = "probing"
    practice: int = 0
    blocks: int = 1

    task = _kind = "same-different"
    _types = (("AA", "BB"), ("AB", "BA"))
    question = "Was it the same material twice, or two different ones?"
    answers = ("same", "different")

    def __post_init__(self) -> None:
        rendered("a", self.a)
        rendered("b", self.b)
        refuse(self.a.name == self.b.name, f"a and b must have different names, got {self.a.name!r} twice")
        self._check("AA, AB, BA, BB", 4)

    def _trial(self, draws: Draws, kind: str, number: int, phase: Phase, block: int) -> Trial:
        intervals = tuple(
            Interval(self.a if x == "A" else self.b, draws.interval_seed(), self.interval) for x in kind
        )
        return Trial(number, phase, block, kind, intervals, "same" if kind[0] == kind[1] else "different")

    def power(self, subjects: int = 1) -> str:
        return self._power(
            f"{self.a.name} or {self.b.name} in two intervals of {self.interval:g} s ({self.mode}), chance 0.5",
            subjects,
        )
