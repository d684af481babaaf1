"""Inhomogeneous bone: a random field of occupancy that depends on seed and position alone."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from burrlab._core import Burr
from burrlab.bone.specimen import Specimen, Vector, block_below_plane
from burrlab.common.check import real, refuse
from burrlab.common.progress import doing
from burrlab.common.study import stored_as

Floats = NDArray[np.float64]

#: Noise nodes per correlation length: the variance varies by 2 exp(-2 pi^2), 5e-9, between nodes.
NODES_A_LENGTH = 2
#: Nodes on either side of a point; the Gaussian weight of the first node left out is below 2e-7.
REACH = 8
#: Edge of the cubes in which noise is drawn [nodes].
CUBE = 8
#: Second key word of the noise: no other use of the same seed shares it.
STREAM = 0xB09EF1E1D
#: Voxel layers filled at a time; this limits the memory.
LAYERS = 16


@stored_as("burrlab.bone_field.BoneField")
@dataclass(frozen=True)
class BoneField:
    r"""Bone whose occupancy varies from place to place.

    With g a stationary Gaussian field of mean 0, variance 1 and correlation

    .. math::

       E[g(x)\, g(x + d)] = e^{-d^2/(2 L^2)},

    the occupancy is B^-1(Phi(g)). Phi is the normal distribution function, B^-1 the quantile function of the
    beta distribution with the given mean and standard deviation.

    Parameters
    ----------
    mean : float
        Mean occupancy of solid bone, in (0, 1].
    contrast : float
        Standard deviation of the occupancy over its mean; 0 is homogeneous bone.
    correlation_length : float
        L [mm]. Places L apart correlate by 0.61, 2 L apart by 0.14.

    Raises
    ------
    ValueError
        If mean is outside (0, 1]; contrast is negative or not below sqrt((1 - mean)/mean), the limit for an
        occupancy between 0 and 1; the standard deviation is not 0 but below one of 255 levels; or
        correlation_length is not positive and finite.

    Notes
    -----
    The form of the correlation (the squared exponential of geostatistics) and the beta distribution are ours.
    A beta distribution lies in 0..1, so nothing is clipped, and mean and contrast hold exactly but for rounding to
    levels. The correlation of the occupancy is within 0.02 of that of g if the beta distribution is nearly normal,
    and lower if it is skew.

    g is Gaussian white noise on a lattice of spacing L/2, smoothed by a Gaussian of standard deviation
    L/sqrt(2) at the voxel centres, and divided by the root of the sum of its squared weights. g thus depends
    on seed and position alone, not on voxel size or block; a larger block continues a smaller one.

    Weights are products over the axes, so a block for R = 3 mm at 0.1 mm takes 5 ms. A sum of 1000 random
    cosines is as independent of the grid, but takes 50 times as long and is only nearly Gaussian. Noise comes
    from a counter-based generator (Philox; key: seed, counter: place of a cube of nodes).

    In one bone (contrast 0.1 and 0.2, L = 0.25 to 1 mm, 0.5 and 2 N) the mean velocity at 0.05, 0.2 and 0.25
    mm is within 1.3 % of that at 0.1 mm, also where L is one voxel. Homogeneous bone shows the same.

    Examples
    --------
    >>> import burrlab
    >>> from burrlab.bone.uneven import BoneField
    >>> field = BoneField(mean=0.8, contrast=0.1, correlation_length=0.5)
    >>> specimen = field.specimen(burrlab.Burr(3.0), 0.2, seed=1)
    >>> run = burrlab.descend(burrlab.Burr(3.0), burrlab.materials["bone"], 1.0, specimen=specimen, seed=1, ideal=True)
    >>> run.status
    'ok'
    """

    mean: float = 0.8
    contrast: float = 0.1
    correlation_length: float = 0.5

    def __post_init__(self) -> None:
        for name in ("mean", "contrast", "correlation_length"):
            real(getattr(self, name), name)
        refuse(not 0 < self.mean <= 1, f"mean must be above 0 and at most 1, got {self.mean}")
        most = np.sqrt((1 - self.mean) / self.mean)
        refuse(
            not (self.contrast == 0 or 0 < self.contrast < most),
            f"contrast must be 0 or between 0 and sqrt((1 - mean)/mean) = {most:.4g}, got {self.contrast}",
        )
        refuse(
            0 < self.contrast * self.mean * 255 < 1,
            f"contrast must be 0 or give a standard deviation of at least one level, 1/(255 mean) = "
            f"{1 / (255 * self.mean):.4g}, got {self.contrast}",
        )
        refuse(
            not 0 < self.correlation_length < np.inf,
            f"correlation_length must be positive and finite, got {self.correlation_length}",
        )

    @doing("making uneven bone")
    def levels(self, x: ArrayLike, y: ArrayLike, z: ArrayLike, *, seed: int) -> NDArray[np.uint8]:
        """Levels of the bone at the points of a grid.

        Parameters
        ----------
        x, y, z : array_like, shape (n_x,), (n_y,), (n_z,)
            Coordinates of the grid [mm].
        seed : int
            Seed of the field.

        Returns
        -------
        ndarray of uint8, shape (n_z, n_y, n_x)
            Occupancy, 0..255.

        Raises
        ------
        ValueError
            If the seed is not in 0..2^64 - 1.
        """
        refuse(not 0 <= seed < 2**64, f"seed must be a whole number from 0 and below 2^64, got {seed}")
        axes = [np.asarray(c, dtype=float) for c in (z, y, x)]
        out = np.full([len(c) for c in axes], np.rint(255 * self.mean), dtype=np.uint8)
        if self.contrast == 0 or out.size == 0:
            return out
        # Thresholds of g for each level: exact, without a beta quantile per voxel.
        total = (1 - self.mean) / (self.mean * self.contrast**2) - 1  # of the beta distribution's a and b
        a, b = self.mean * total, (1 - self.mean) * total
        threshold = special.ndtri(special.betainc(a, b, (np.arange(255) + 0.5) / 255))
        stencils = [_stencil(c * (NODES_A_LENGTH / self.correlation_length)) for c in axes]
        low = [int(first.min()) for first, _ in stencils]
        high = [int(first.max()) + 2 * REACH for first, _ in stencils]
        noise = _white_noise(low, high, int(seed))
        (first_z, weight_z), (first_y, weight_y), (first_x, weight_x) = stencils
        for begin in range(0, len(first_z), LAYERS):
            rows = slice(begin, begin + LAYERS)
            g = _smooth(noise, first_z[rows] - low[0], weight_z[:, rows], 0)
            g = _smooth(g, first_y - low[1], weight_y, 1)
            g = _smooth(g, first_x - low[2], weight_x, 2)
            out[rows] = np.searchsorted(threshold, g, side="right")
        return out

    def specimen(
        self,
        burr: Burr,
        voxel: float | Vector,
        *,
        depth: float | None = None,
        seed: int,
        axis: Vector = (0.0, 0.0, -1.0),
        offset: Vector = (0.0, 0.0, 0.0),
    ) -> Specimen:
        """This bone below a plane through the origin, in a block like that of `half_space`.

        Parameters
        ----------
        burr, voxel, depth, axis, offset
            See `half_space`. The offset moves the burr, not the field.
        seed : int
            Seed of the field; another seed is another bone.

        Returns
        -------
        Specimen
            Voxels hold the occupancy at their centres, times their fraction below the plane.

        Raises
        ------
        ValueError
            If the seed is not in 0..2^64 - 1 or the correlation length is below a voxel; and as `half_space`.
        """

        def filled(centers: tuple[Floats, ...], fraction: Floats, spacing: Floats) -> NDArray[np.uint8]:
            # At a spacing of L, voxel centres cannot represent 0.2 % of g's variance along each axis.
            refuse(
                self.contrast > 0 and self.correlation_length < spacing.max(),
                f"correlation_length must be at least one voxel, {spacing.max():g} mm, "
                f"got {self.correlation_length:g} mm",
            )
            return np.rint(fraction * self.levels(*centers, seed=seed)).astype(np.uint8)

        source = (
            f"half-space of uneven bone, mean {self.mean:g}, contrast {self.contrast:g}, "
            f"correlation length {self.correlation_length:g} mm, seed {seed}"
        )
        return block_below_plane(burr, voxel, filled, source, depth=depth, axis=axis, offset=offset)


def _stencil(place: Floats) -> tuple[NDArray[np.int64], Floats]:
    """First node (n,) and weights (2 REACH, n) of places in node spacings; squared weights sum to 1."""
    first = np.floor(place).astype(np.int64) - (REACH - 1)
    distance = place - (first + np.arange(2 * REACH)[:, None])
    # The kernel has a variance of L^2/2, here NODES_A_LENGTH^2/2; its autocorrelation is that of g.
    weight = np.exp(-((distance / NODES_A_LENGTH) ** 2))
    return first, weight / np.sqrt(np.sum(weight**2, axis=0))


def _smooth(field: Floats, first: NDArray[np.int64], weight: Floats, axis: int) -> Floats:
    """Weighted sums along an axis in a fixed order: every block gets the same bits, unlike with a BLAS."""
    weights = weight.reshape([len(weight), *(-1 if k == axis else 1 for k in range(3))])
    total = weights[0] * np.take(field, first, axis=axis)
    for k in range(1, len(weights)):
        total += weights[k] * np.take(field, first + k, axis=axis)
    return np.asarray(total)


def _white_noise(low: list[int], high: list[int], seed: int) -> Floats:
    """Standard normal draws at nodes low..high - 1 (z, y, x); each depends on seed and node alone."""
    begin = [i // CUBE for i in low]
    count = [-(-j // CUBE) - i for i, j in zip(begin, high, strict=True)]
    uniform = np.empty([CUBE * n for n in count])
    for cube in np.ndindex(*count):
        place = [(i + b) % 2**64 for i, b in zip(cube, begin, strict=True)]
        draws = unit_draws(seed, STREAM, [0, *place], CUBE**3)
        uniform[tuple(slice(CUBE * i, CUBE * (i + 1)) for i in cube)] = draws.reshape(CUBE, CUBE, CUBE)
    inside = tuple(slice(i - CUBE * b, j - CUBE * b) for i, j, b in zip(low, high, begin, strict=True))
    return np.asarray(special.ndtri(uniform[inside]))


def unit_draws(seed: int, stream: int, counter: list[int], count: int) -> Floats:
    """Draws in (0, 1) that depend on the two words of the key and the four of the counter alone."""
    key = np.array([seed, stream], dtype=np.uint64)
    raw = np.random.Philox(key=key, counter=np.array(counter, dtype=np.uint64)).random_raw(count)
    return np.asarray(((raw >> np.uint64(12)).astype(float) + 0.5) * 2.0**-52)
