"""Orders of trials: balanced, random, and a function of (seed, subject, design) alone.

The draws use NumPy's `SeedSequence` and `PCG64`, whose streams are the same in every version of NumPy, and a shuffle
of our own: NumPy's may change, and a run that was interrupted must resume with the same trials.
"""

from __future__ import annotations

import hashlib
import json
import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from burrlab.psychophysics.design import Order
from burrlab.psychophysics.trial import Phase, Trial

T = TypeVar("T")

_WORDS = 8  # of 32 bits, of a SHA-256 digest


class Draws:
    """Random draws of one subject in one design.

    Parameters
    ----------
    seed : int
        Of the experiment, at least 0.
    subject : str
        The name; another name gives other draws.
    design : mapping
        As the design's `to_dict` has it; another design gives other draws.

    Raises
    ------
    ValueError
        If the seed is negative or the subject has no name.
    TypeError
        If the seed is not whole or the name not a text.

    Examples
    --------
    >>> Draws(1, "01", {}).shuffled("abcd")
    ['d', 'a', 'b', 'c']
    """

    def __init__(self, seed: int, subject: str, design: Mapping[str, Any]) -> None:
        if not isinstance(subject, str):
            raise TypeError(f"subject must be a str, such as '01', got {subject!r}")
        if not subject:
            raise ValueError("subject must have a name, got ''")
        if (seed := operator.index(seed)) < 0:
            raise ValueError(f"seed must be at least 0, got {seed}")
        # Python's own hash differs from one process to the next.
        text = json.dumps([subject, design], sort_keys=True, allow_nan=False)
        words = np.frombuffer(hashlib.sha256(text.encode()).digest(), dtype="<u4")
        entropy = [seed, *(int(word) for word in words[:_WORDS])]
        self._bits = np.random.PCG64(np.random.SeedSequence(entropy))
        self._seeds: set[int] = set()

    def below(self, end: int) -> int:
        """A whole number from 0 to end - 1, each equally likely."""
        most = (1 << 64) - (1 << 64) % end
        while (bits := int(self._bits.random_raw())) >= most:
            pass
        return bits % end

    def shuffled(self, values: Sequence[T]) -> list[T]:
        """The values in an order of which all are equally likely (Fisher and Yates)."""
        result = list(values)
        for last in range(len(result) - 1, 0, -1):
            other = self.below(last + 1)
            result[last], result[other] = result[other], result[last]
        return result

    def interval_seed(self) -> int:
        """A seed of 64 bits that this subject did not have in this design."""
        while (seed := int(self._bits.random_raw())) in self._seeds:
            pass
        self._seeds.add(seed)
        return seed

    def balanced(self, groups: Sequence[Sequence[T]], trials: int, blocks: int = 1) -> list[list[T]]:
        """Types of trials in random order, equally often in all and as nearly as can be in each block.

        Parameters
        ----------
        groups : sequence of sequences
            The types; groups of equal size, such as pairs that are the same and pairs that differ. In a block that is
            no multiple of all types the groups are as often as one another, within one.
        trials : int
            A multiple of `blocks`. If it is one of the types too, all types are equally often.
        blocks : int, optional

        Returns
        -------
        list of lists
            A list a block. Where the size of a block is a multiple of the types, each is as often in it as the others;
            else as often within one.
        """
        size = trials // blocks
        # One type of each group in turn: any consecutive few hold each at most once and the groups alike.
        turn = [
            value
            for together in zip(*(self.shuffled(group) for group in self.shuffled(groups)), strict=True)
            for value in together
        ]
        whole, rest = divmod(size, len(turn))
        extras = [[turn[(block * rest + i) % len(turn)] for i in range(rest)] for block in range(blocks)]
        return [self.shuffled(turn * whole + extra) for extra in self.shuffled(extras)]


class FixedOrder(Order):
    """Trials that do not depend on the answers.

    Parameters
    ----------
    trials : sequence of Trial
    answers : tuple of str
        The set that a response is from.
    """

    def __init__(self, trials: Sequence[Trial], answers: tuple[str, ...]) -> None:
        self.trials = tuple(trials)
        self.answered = []
        self._answers = answers

    @property
    def total(self) -> int:
        return len(self.trials)

    def next(self) -> Trial | None:
        done = len(self.answered)
        return self.trials[done] if done < len(self.trials) else None

    def answer(self, response: str) -> None:
        self.answered.append((checked_trial(self.next(), response, self._answers), response))


def fixed_order(
    draws: Draws,
    groups: Sequence[Sequence[T]],
    make: Callable[[T, int, Phase, int], Trial],
    *,
    trials: int,
    blocks: int,
    practice: int,
    answers: tuple[str, ...],
) -> FixedOrder:
    """Practice, then blocks, each balanced (`Draws.balanced`); `make` is given type, number, phase and block."""
    first = draws.balanced(groups, practice)[0]
    order = [make(kind, number, "practice", 0) for number, kind in enumerate(first, 1)]
    number = 0
    for block, kinds in enumerate(draws.balanced(groups, trials, blocks), 1):
        for kind in kinds:
            number += 1
            order.append(make(kind, number, "main", block))
    return FixedOrder(order, answers)


def checked_trial(trial: Trial | None, response: str, answers: tuple[str, ...]) -> Trial:
    """The trial that a response answers.

    Raises
    ------
    ValueError
        If the response is not one of the answers, or there is no trial left.
    """
    if trial is None:
        raise ValueError(f"there is no trial left to answer, got {response!r}")
    if response not in answers:
        raise ValueError(f"response must be one of {', '.join(answers)}, got {response!r}")
    return trial


def counterbalanced(names: Sequence[T], subject_index: int) -> list[T]:
    """The order of tasks for one subject, from Williams' Latin squares.

    Over every n subjects (n tasks) each task is equally often in each place; over every n (n even) or 2 n (n odd)
    each also follows each other equally often.

    Parameters
    ----------
    names : sequence
    subject_index : int
        From 0, in the order of the protocol's list.

    Raises
    ------
    ValueError
        If there is no name, a name is there twice, or the index is negative.

    References
    ----------
    E. J. Williams, Experimental designs balanced for the estimation of residual effects of treatments, Australian
    Journal of Scientific Research A 2 (1949) 149-168.

    Examples
    --------
    >>> [counterbalanced(["probing", "drilling"], subject) for subject in range(3)]
    [['probing', 'drilling'], ['drilling', 'probing'], ['probing', 'drilling']]
    """
    n = len(names)
    if n == 0:
        raise ValueError("names must hold at least one, got none")
    if any(name in names[:i] for i, name in enumerate(names)):
        raise ValueError(f"names must differ, got {list(names)!r}")
    if (subject := operator.index(subject_index)) < 0:
        raise ValueError(f"subject_index must be at least 0, got {subject}")
    # 0, 1, n-1, 2, n-2, ...: all differences of neighbours occur once
    first = [(i + 1) // 2 if i % 2 else (n - i // 2) % n for i in range(n)]
    row = [names[(place + subject) % n] for place in first]
    return row[::-1] if n % 2 and subject // n % 2 else row
