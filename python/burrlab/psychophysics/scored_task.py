"""A task with a score, same-different or ABX: its subjects, and the group."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from burrlab.psychophysics.d_prime import binomial_test, d_prime, score_interval
from burrlab.psychophysics.equivalence import Equivalence, equivalence
from burrlab.psychophysics.group import GroupDPrime, GroupScore, group_d_prime, group_score
from burrlab.psychophysics.pair_checks import pair_checks
from burrlab.psychophysics.rules import RuleName, TaskName
from burrlab.psychophysics.selection import SelectionEffect
from burrlab.psychophysics.subject_result import SubjectResult, holm
from burrlab.psychophysics.task_data import SubjectData, TaskData

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CORRECTION = "log-linear"


@dataclass(frozen=True)
class ScoredTask:
    """One task: its subjects, and the group with the subject as the unit.

    Attributes
    ----------
    name : str
    task : {"same-different", "abx", "2ifc"}
    design : mapping
        As `Design.to_dict` has it; empty where the counts came alone.
    level : float
        Of all intervals.
    rules : tuple of str
        Decision rules that d' is given under.
    delta : float or None
        d' that an equivalence test asks about.
    subjects : tuple of SubjectResult
    left_out : tuple of str
        Subjects whose run is incomplete, with how far they came.
    selection : SelectionEffect or None
        Where subjects were selected and answered equally many trials.
    selected_by : str
    score : GroupScore or None
        None of a single subject.
    group_d_prime : tuple of GroupDPrime
        One a rule; none of a single subject.
    equivalence : tuple of Equivalence
        One a rule; none without a delta.
    warnings : tuple of str
    """

    name: str
    task: TaskName
    design: Mapping[str, Any]
    level: float
    rules: tuple[RuleName, ...]
    delta: float | None
    subjects: tuple[SubjectResult, ...]
    left_out: tuple[str, ...]
    selection: SelectionEffect | None
    selected_by: str
    score: GroupScore | None
    group_d_prime: tuple[GroupDPrime, ...]
    equivalence: tuple[Equivalence, ...]
    warnings: tuple[str, ...]
