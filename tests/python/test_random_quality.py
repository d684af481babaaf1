"""Quality of the tick's 16-bit random numbers as fields over voxel, tick, burr index and seed (docs/tick.md).

A statistic returns two-sided probabilities that independent uniform numbers deviate as far as these. It rejects
where the smallest, times their count (Bonferroni), is below FALSE_ALARM; each statistic as a whole is thus wrong
with at most that probability. Keys are those of runs: small seeds, ticks and indices, and those at which a 32-bit
word carries over.
"""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any
from unittest import mock

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import burrlab._core as _core
from reference import tick as reference

FALSE_ALARM = 1e-6  # of each statistic as a whole

Lanes = NDArray[np.uint16]
Source = Callable[..., Lanes]
Probabilities = NDArray[np.float64]
Shape = tuple[int, int, int]
Key = tuple[int, int, int, int]  # seed, tick, index, draw

VOLUME: Shape = (128, 128, 128)
MEAN, VARIANCE = 65535 / 2, (65536**2 - 1) / 12


def reference_lanes(rounds: int) -> Source:
    """The reference's numbers, with another number of Philox rounds."""
    philox = partial(reference.philox4x32, rounds=rounds)

    def draws(shape: Shape, seed: int, tick: int, index: int = 0, draw: int = 0) -> Lanes:
        with mock.patch.object(reference, "philox4x32", philox):
            return reference.draw_lanes(shape, seed, tick, index, draw).astype(np.uint16)

    return draws


# --- Probabilities ----------------------------------------------------------------------------------------


def two_sided(law: Any, statistic: Any, step: int = 0) -> Probabilities:
    """Two-sided probability of a statistic that goes in steps of `step`; 0: continuous."""
    return np.ravel(np.minimum(1.0, 2.0 * np.minimum(law.cdf(statistic), law.sf(statistic - step))))


def chi_square(counts: NDArray[np.int64]) -> Probabilities:
    """Pearson's test of equal bins along the last axis; counts that are too even deviate too."""
    expected = counts.mean(axis=-1, keepdims=True)
    return two_sided(stats.chi2(counts.shape[-1] - 1), ((counts - expected) ** 2 / expected).sum(axis=-1))


def binomial(counts: NDArray[np.int64], throws: NDArray[np.int64] | int, chance: float) -> Probabilities:
    """Exact test of counts of an event of known probability."""
    return two_sided(stats.binom(throws, chance), counts, 1)


def normal(z: float) -> Probabilities:
    """Test of a sum of many terms, given in standard deviations."""
    return two_sided(stats.norm, z)


def sum_of_squares(z: NDArray[np.float64]) -> Probabilities:
    """Test of standardised sums of bounded terms; these vary less than normal ones, so the bound holds."""
    return two_sided(stats.chi2(z.size), (z**2).sum())


def false_alarm(probabilities: Probabilities) -> float:
    """Bound on the probability that good numbers look as bad as these."""
    return float(probabilities.min()) * probabilities.size


# --- Statistics: source of the numbers, repeats -> probabilities --------------------------------------------


def uniformity(source: Source, repeats: int) -> Probabilities:
    """Frequencies of values, bytes and bits in each of a block's eight lanes and in all; the worst value."""
    lane = (np.arange(VOLUME[1], dtype=np.int32) % 8)[:, None] << 16
    counts = np.zeros((9, 65536), dtype=np.int64)
    for tick in range(repeats):
        counts[:8] += np.bincount((lane | source(VOLUME, 1, tick)).ravel(), minlength=8 * 65536).reshape(
            8, -1
        )
    counts[8] = counts[:8].sum(axis=0)
    square, throws, value = counts.reshape(9, 256, 256), counts.sum(axis=1), np.arange(65536)
    ones = np.stack([counts[:, value >> bit & 1 == 1].sum(axis=1) for bit in range(16)])
    bins = map(chi_square, (counts, square.sum(axis=1), square.sum(axis=2)))
    worst_value = false_alarm(binomial(counts[8], int(throws[8]), 1 / 65536))
    return np.concatenate([*bins, binomial(ones, throws, 0.5), [min(1.0, worst_value)]])


def unrelated(pairs: Iterable[tuple[Lanes, Lanes]]) -> Probabilities:
    """Joint uniformity of two numbers (high 4 bits, low 4 bits, bytes of a ^ b) and their correlation."""
    counts, products, n = np.zeros((4, 256), dtype=np.int64), 0.0, 0
    for a, b in pairs:
        mixed = a ^ b
        cells = (a >> 12 << 4 | b >> 12, (a & 15) << 4 | b & 15, mixed >> 8, mixed & 255)
        counts += [np.bincount(cell.ravel(), minlength=256) for cell in cells]
        products += float(np.vdot(a - MEAN, b - MEAN))
        n += a.size
    return np.concatenate([chi_square(counts), normal(products / (VARIANCE * n**0.5))])


def neighbours(axis: int, source: Source, repeats: int) -> Probabilities:
    """Voxels (2i, 2i + 1) and (2i + 1, 2i + 2); along y the first pair is the two halves of a word."""

    def pairs(first: int) -> Iterable[tuple[Lanes, Lanes]]:
        for tick in range(repeats):
            row = np.moveaxis(source(VOLUME, 1, tick), axis, 0)
            yield row[first:-1:2], row[first + 1 :: 2]

    return np.concatenate([unrelated(pairs(0)), unrelated(pairs(1))])


RELATED: dict[str, list[tuple[Key, Key]]] = {
    "ticks": [((1, 0, 0, 0), (1, 1, 0, 0)), ((1, 2**32 - 1, 0, 0), (1, 2**32, 0, 0))],
    "burrs": [((1, 0, 0, 0), (1, 0, 1, 0)), ((1, 0, 2**31 - 2, 0), (1, 0, 2**31 - 1, 0))],
    "seeds": [((1, 0, 0, 0), (2, 0, 0, 0)), ((2**32 - 1, 0, 0, 0), (2**32, 0, 0, 0))],
    "seed bits": [((1, 0, 0, 0), (1 ^ 1 << bit, 0, 0, 0)) for bit in range(64)],
    "U and V": [((1, 0, 0, 0), (1, 0, 0, 1)), ((1, 0, 1, 0), (1, 0, 0, 1))],
    "crossed": [((2, 0, 0, 0), (1, 1, 0, 0)), ((1, 1, 0, 0), (1, 0, 1, 0)), ((2, 0, 0, 0), (1, 0, 1, 0))],
}


def related(name: str, source: Source, repeats: int) -> Probabilities:
    """The same voxel in two fields that differ by tick, burr index, seed, draw, or by two of these."""
    shape = (16, 64, 64) if name == "seed bits" else VOLUME

    def field(key: Key, repeat: int) -> Lanes:
        seed, tick, index, draw = key
        along = (repeat, 0) if name == "ticks" else (0, repeat)  # no field occurs twice
        return source(shape, seed + along[0], tick + along[1], index, draw)

    return np.concatenate(
        [unrelated((field(a, i), field(b, i)) for i in range(repeats)) for a, b in RELATED[name]]
    )


def flips(pairs: Iterable[tuple[Lanes, Lanes]]) -> Probabilities:
    """Blocks (8, n) that differ by one input bit; 128 output bits flip unrelated, with probability 1/2."""
    heads, weight = np.zeros(128, dtype=np.int64), []
    for a, b in pairs:
        bits = np.unpackbits(np.ascontiguousarray((a ^ b).reshape(8, -1).T).view(np.uint8), axis=1)
        heads += bits.sum(axis=0, dtype=np.int64)
        weight.append(bits.sum(axis=1, dtype=np.int64))
    z = (np.concatenate(weight) - 64.0) / 32.0**0.5
    return np.concatenate([binomial(heads, z.size, 0.5), sum_of_squares(z)])


def avalanche(source: Source, repeats: int) -> Probabilities:
    """Flips of one bit of seed (64), tick (64), index (31), draw (1) or column number (18 here)."""
    shape, bases = (1, 8, 1024), [(i, i, i, 0) for i in range(repeats)]
    bases += [(0x9E3779B97F4A7C15 ^ i, 0x243F6A8885A308D3 ^ i, 0x13198A2E, 0) for i in range(repeats)]
    fields = [source(shape, *base) for base in bases]

    def flipped(word: int, bit: int) -> Iterable[tuple[Lanes, Lanes]]:
        for base, field in zip(bases, fields, strict=True):
            yield field, source(shape, *(k ^ (i == word) << bit for i, k in enumerate(base)))

    columns = [source((1, 8, 2**18), 1, tick) for tick in range(min(repeats, 4))]
    halves = [[field.reshape(8, -1, 2, 2**bit) for field in columns] for bit in range(18)]
    found = [flips(flipped(word, bit)) for word, size in enumerate((64, 64, 31, 1)) for bit in range(size)]
    found += [flips((half[:, :, 0], half[:, :, 1]) for half in split) for split in halves]
    return np.concatenate(found)


def voxel_over_ticks(source: Source, repeats: int) -> Probabilities:
    """Repeated values in 4096 ticks of a voxel, and repeated spacings of its 2048 32-bit numbers (birthdays).

    The number of values never drawn has the law of a sum of independent indicators (Vatutin, Mikhailov 1982),
    for which Bernstein's inequality holds. Repeated spacings are Poisson with mean n^3/(4 d) for up to 64 voxels
    (Marsaglia 1985; TestU01 asks that 8 times the mean be at most d^(1/4)).
    """
    n, d = 4096, 65536
    history = np.stack([source((1, 8, 8 * repeats), 1, tick).ravel() for tick in range(n)]).astype(np.int64)
    voxels = history.shape[1]
    met = voxels + np.count_nonzero(np.diff(np.sort(history, axis=0), axis=0))
    one, two = (1 - 1 / d) ** n, (1 - 2 / d) ** n
    variance = voxels * d * (one - two + d * (two - one**2))
    away = abs(met - voxels * d * (1 - one))
    repeated_values = min(1.0, 2.0 * np.exp(-(away**2) / (2.0 * (variance + away / 3.0))))

    birthday = np.sort((history[::2] << 16 | history[1::2])[:, :64], axis=0)
    spacing = np.sort(np.diff(birthday, axis=0, append=birthday[:1] + 2**32), axis=0)
    repeated = np.count_nonzero(np.diff(spacing, axis=0) == 0)
    return np.append(two_sided(stats.poisson(64 * (n / 2) ** 3 / 2**34), repeated, 1), repeated_values)


def bricks(source: Source, repeats: int) -> Probabilities:
    """Sums over bricks of 8^3 voxels, of numbers and low bytes: law (Kolmogorov-Smirnov), mean, variance."""
    found = []
    for values in (65536, 256):
        parts = (source(VOLUME, 1, tick) & (values - 1) for tick in range(repeats))
        sums = [p.reshape(16, 8, 16, 8, 16, 8).sum(axis=(1, 3, 5), dtype=np.int64).ravel() for p in parts]
        z = (np.concatenate(sums) - 256 * (values - 1)) / (512 * (values**2 - 1) / 12) ** 0.5
        found += [stats.kstest(z, "norm").pvalue, *sum_of_squares(z), *normal(z.sum() / z.size**0.5)]
    return np.array(found)


def plane(axes: str, source: Source, seed: int) -> Lanes:
    """512 x 512 numbers: a plane of the volume, or a row of voxels over ticks."""
    if "t" in axes:
        shape = (1, 1, 512) if "x" in axes else (1, 512, 1)
        return np.stack([source(shape, seed, tick).ravel() for tick in range(512)])
    nz, ny, nx = (512 if axis in axes else 1 for axis in "zyx")
    return source((nz, ny, nx), seed, 0).reshape(512, 512)


def spectrum(source: Source, repeats: int) -> Probabilities:
    """2-D power spectra of planes: no peak, and the spread of white noise (Kolmogorov-Smirnov)."""
    found = []
    for axes in ("zy", "zx", "yx", "ty", "tx"):
        transforms = (np.fft.rfft2(plane(axes, source, seed) - MEAN) for seed in range(repeats))
        power = sum(np.abs(transform) ** 2 / (512**2 * VARIANCE) for transform in transforms)
        edge = power[:, [0, 256]]  # these columns are their own conjugates
        twofold = np.concatenate([power[:, 1:256].ravel(), edge[1:256].ravel()])
        law = stats.gamma(repeats)
        found += [twofold.size * law.sf(twofold.max()), stats.kstest(twofold, law.cdf).pvalue]
        found += list(4 * stats.chi2(repeats).sf([edge[[0, 256]].max()]))
    return np.minimum(1.0, found)


# Each with the most Philox rounds that it rejects in one repeat; the core uses seven.
STATISTICS: dict[str, tuple[Callable[[Source, int], Probabilities], int]] = {
    "uniformity": (uniformity, 4),
    "neighbours z": (partial(neighbours, 0), 5),
    "neighbours y": (partial(neighbours, 1), 3),
    "neighbours x": (partial(neighbours, 2), 5),
    "ticks": (partial(related, "ticks"), 6),
    "burrs": (partial(related, "burrs"), 6),
    "seeds": (partial(related, "seeds"), 5),
    "seed bits": (partial(related, "seed bits"), 5),
    "U and V": (partial(related, "U and V"), 5),
    "crossed": (partial(related, "crossed"), 5),
    "avalanche": (avalanche, 6),
    "voxel over ticks": (voxel_over_ticks, 5),
    "bricks": (bricks, 4),
    "spectrum": (spectrum, 5),
}


every_statistic = pytest.mark.parametrize(("statistic", "rounds"), STATISTICS.values(), ids=STATISTICS)


@every_statistic
def test_numbers_pass(statistic: Callable[[Source, int], Probabilities], rounds: int) -> None:
    """No statistic rejects the core's numbers, about 2e6 for each comparison."""
    assert false_alarm(statistic(_core.draws, 1)) >= FALSE_ALARM


@every_statistic
def test_too_few_rounds_fail(statistic: Callable[[Source, int], Probabilities], rounds: int) -> None:
    """The same statistic of the same size rejects Philox with fewer rounds."""
    assert false_alarm(statistic(reference_lanes(rounds), 1)) < FALSE_ALARM


@pytest.mark.slow
@every_statistic
def test_seven_rounds_pass_where_ten_do(
    statistic: Callable[[Source, int], Probabilities], rounds: int
) -> None:
    """Sixteen times the numbers, 1e9 in all, pass with seven rounds (the core) and with ten."""
    seven, ten = (false_alarm(statistic(source, 16)) for source in (_core.draws, reference_lanes(10)))
    assert min(seven, ten) >= FALSE_ALARM / 2


def test_avalanche_of_upper_column_bits() -> None:
    """Bits 18 to 31 of the column number, which only large volumes use, flip the reference's output bits."""

    def block(column: NDArray[np.uint64]) -> Lanes:
        return np.stack(reference.philox4x32((column, 0, 0, 0), (1, 0)), axis=-1).astype("<u4").view("<u2").T

    column = np.arange(2**14, dtype=np.uint64)
    found = [flips([(block(column), block(column ^ np.uint64(1 << bit)))]) for bit in range(18, 32)]
    assert false_alarm(np.concatenate(found)) >= FALSE_ALARM
