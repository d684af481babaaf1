"""One tick of a burr on a voxel bone, written from docs/tick.md line by line; equal to the core bit for bit.

The tick visits every voxel of the volume. Numbers called f32 on that page are ``numpy.float32`` arrays and
scalars; none is combined with a Python float, so no version of NumPy promotes them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

f32 = np.float32
Float = NDArray[np.float32]
Integer = NDArray[np.int64]
Word = NDArray[np.uint64]

ZERO, HALF, ONE, TWO = f32(0), f32(0.5), f32(1), f32(2)
WORD = 0xFFFFFFFF


# --- Random numbers ---------------------------------------------------------------------------------------


def philox4x32(counter: Sequence[Word | int], key: Sequence[int], rounds: int = 7) -> list[Word]:
    """Philox4x32 of Salmon, Moraes, Dror and Shaw (SC 2011).

    Parameters
    ----------
    counter : sequence of 4
        Counter words, integers or arrays below 2^32.
    key : sequence of 2 int
        Key words below 2^32.
    rounds : int
        The tick draws with 7.

    Returns
    -------
    list of 4 ndarray of uint64
        Output words, below 2^32.
    """
    word, low_bits = np.uint64(WORD), np.uint64(32)
    c0, c1, c2, c3 = (np.asarray(c, dtype=np.uint64) for c in counter)
    k0, k1 = key
    for _ in range(rounds):
        product0, product1 = np.uint64(0xD2511F53) * c0, np.uint64(0xCD9E8D57) * c2
        c0, c1, c2, c3 = (
            (product1 >> low_bits) ^ c1 ^ np.uint64(k0),
            product1 & word,
            (product0 >> low_bits) ^ c3 ^ np.uint64(k1),
            product0 & word,
        )
        k0, k1 = (k0 + 0x9E3779B9) & WORD, (k1 + 0xBB67AE85) & WORD
    return [c0, c1, c2, c3]


def draw_lanes(shape: tuple[int, int, int], seed: int, tick: int, index: int, draw: int) -> Integer:
    """The 16-bit random number of every voxel of a volume.

    Parameters
    ----------
    shape : tuple of 3 int
        Volume size (nz, ny, nx).
    seed, tick : int
        Below 2^64.
    index : int
        Burr index, below 2^31.
    draw : int
        0 for U, 1 for V.

    Returns
    -------
    ndarray of int64, (nz, ny, nx)
        0..65535.
    """
    nz, ny, nx = shape
    rows_of_columns = (ny + 7) // 8
    column = np.arange(nz * rows_of_columns * nx, dtype=np.uint64).reshape(nz, rows_of_columns, nx)
    words = philox4x32((column, tick & WORD, tick >> 32, index + 2**31 * draw), (seed & WORD, seed >> 32))
    half, low_bits = np.uint64(0xFFFF), np.uint64(16)
    lanes = np.stack([lane for word in words for lane in (word & half, word >> low_bits)], axis=2)
    return lanes.reshape(nz, rows_of_columns * 8, nx)[:, :ny, :].astype(np.int64)


# --- The erosion shape f ----------------------------------------------------------------------------------


def portable_exp(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """e^x, operation by operation as in portable_math.hpp."""
    n = np.rint(x * 1.44269504088896338700)
    r = (x - n * 0.693147180369123816490) - n * 1.90821492927058770002e-10
    total = np.ones_like(x)
    for k in range(16, 0, -1):
        total = 1.0 + total * r / k
    return np.where(x < -745.0, 0.0, np.ldexp(total, n.astype(np.int32)))


def portable_log(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Natural logarithm of x > 0, operation by operation as in portable_math.hpp."""
    mantissa, exponent = np.frexp(x)
    small = mantissa < 0.70710678118654752
    mantissa = np.where(small, mantissa * 2.0, mantissa)
    exponent = np.where(small, exponent - 1, exponent)
    z = (mantissa - 1.0) / (mantissa + 1.0)
    z2 = z * z
    total = np.zeros_like(x)
    for k in range(23, 0, -2):
        total = total * z2 + 1.0 / k
    return 2.0 * z * total + exponent * 0.693147180559945309417


def portable_pow(x: NDArray[np.float64], k: float) -> NDArray[np.float64]:
    """x^k for x >= 0 and k > 0, operation by operation as in portable_math.hpp."""
    positive = x > 0.0
    return np.where(positive, portable_exp(k * portable_log(np.where(positive, x, 1.0))), 0.0)


def portable_power(x: float, k: float) -> float:
    """x^k for x >= 0 and k > 0: a product for whole k, operation by operation as in portable_math.hpp."""
    if k != int(k):
        return float(portable_pow(np.float64(x), k))
    product = x
    for _ in range(int(k) - 1):
        product *= x
    return product


#: y and k of f = y^k, where y is 1, the depth 1 - x below the sphere's surface, or 1 - x^2.
SHAPES = {
    "parabolic": ("square", 1.0),
    "linear": ("depth", 1.0),
    "quartic": ("square", 2.0),
    "constant": ("one", 0.0),
}


@dataclass(frozen=True)
class ReferenceShape:
    """An erosion shape by its name: one of `SHAPES`, power(k), (1 - x^2)^k, or a table."""

    name: str

    @property
    def base(self) -> str:
        """Name of y."""
        return "depth" if self.name.startswith("table(") else SHAPES.get(self.name, ("square", 0.0))[0]

    @property
    def order(self) -> float:
        """k, the order of the zero of f at r = R; 0 for constant."""
        if self.name in SHAPES:
            return SHAPES[self.name][1]
        return float(self.name[6:-1].split(";")[0])

    @property
    def layer_order(self) -> float:
        """k of the effective depth."""
        return self.order or float(self.base == "depth")

    def tabulated(self, delta: Float) -> Float:
        """y of the table (f32)."""
        rows = [row.split(":") for row in self.name[6:-1].split(";")[1].split(",")][::-1]
        d, y = np.array([(1 - float(x), float(f)) for x, f in rows]).T
        if self.order not in (0, 1):
            y = portable_pow(y, 1 / self.order)
        S = np.append(np.diff(y) / np.diff(d), 0.0).astype(f32)
        D, Y = d.astype(f32), y.astype(f32)
        i = np.maximum(np.searchsorted(D, delta, "right") - 1, 0)
        y = Y[i] + (delta - D[i]) * S[i]
        return np.where((delta > 0) & (y > 0), y, ZERO)

    def raised(self, y: Float) -> Float:
        """y^k (f32)."""
        if self.base == "one":
            return np.ones_like(y)
        if self.order != int(self.order):
            return portable_pow(y.astype(np.float64), self.order).astype(f32)
        result = y  # and for k = 0, of a table
        for _ in range(int(self.order) - 1):
            result = result * y
        return result

    def at_depth(self, delta: Float, deep: NDArray[np.bool_], x2: Float) -> Float:
        """f at the depth delta R below the sphere's surface; for deep voxels from x2 = (r/R)^2 (f32)."""
        if self.base == "depth":
            return self.raised(self.tabulated(delta) if ";" in self.name else delta)
        return self.raised(np.where(deep, ONE - np.where(deep, x2, ZERO), delta * (TWO - delta)))

    def at_radius(self, x: Float, x2: Float) -> Float:
        """f at the distance x R from the centre, zero beyond R; x2 = x^2 (f32)."""
        y = ONE - np.where(x2 > ONE, ONE, x2)
        if self.base == "depth":
            delta = np.maximum(ONE - x, ZERO)
            y = self.tabulated(delta) if ";" in self.name else delta
        return np.where(x2 > ONE, ZERO, self.raised(y))


# --- Geometry, mass, depth, loss: a section of docs/tick.md each -------------------------------------------


@dataclass(frozen=True)
class Geometry:
    """Places of the voxels about the burr, and how much of each it covers."""

    base: tuple[float, float, float]
    frac: tuple[float, float, float]
    distance2: Float
    distance: Float
    width: Float
    inv_width: Float
    coverage: Float
    deep: NDArray[np.bool_]
    isotropic: bool


def geometry(
    center: ArrayLike,
    radius: float,
    shape: tuple[int, int, int],
    spacing: tuple[float, float, float],
    origin: tuple[float, float, float],
) -> Geometry:
    """Position of the burr to 2^-20 voxel; for each voxel distance r, width s, coverage w, whether deep."""
    base, frac, offset = [], [], []
    for c, o, s, n in zip(np.asarray(center, dtype=np.float64), origin, spacing, shape[::-1], strict=True):
        position = (float(c) - o) / s
        whole = float(np.rint(position))
        part = float(np.rint((position - whole) * 2.0**20) / 2.0**20)
        base.append(whole)
        frac.append(part)
        offset.append(((np.arange(n, dtype=np.float64) - whole).astype(f32) - f32(part)) * f32(s))
    dx, dy, dz = offset[0][None, None, :], offset[1][None, :, None], offset[2][:, None, None]

    r2 = (dz * dz + dy * dy) + dx * dx
    r = np.sqrt(r2)
    width, inv_width = np.full_like(r, f32(spacing[0])), np.full_like(r, ONE / f32(spacing[0]))
    isotropic = spacing[0] == spacing[1] == spacing[2]
    if not isotropic:
        ax, ay, az = f32(spacing[0]) * dx, f32(spacing[1]) * dy, f32(spacing[2]) * dz
        g = np.sqrt((az * az + ay * ay) + ax * ax)
        off_centre = r > ZERO
        np.divide(g, r, out=width, where=off_centre)
        np.divide(r, g, out=inv_width, where=off_centre)

    w = np.clip((f32(radius) - r) * inv_width + HALF, f32(2.0**-20), ONE)
    D = f32(radius) - f32(3.5) * f32(max(spacing))
    deep = r2 <= D * D
    return Geometry(tuple(base), tuple(frac), r2, r, width, inv_width, w, deep, isotropic)  # type: ignore[arg-type]


def truncated(x: Float) -> Integer:
    """int(x), towards zero."""
    return x.astype(np.int64)


def mass(q: NDArray[np.uint8], p: NDArray[np.uint8], w: Float, scheme: str) -> Integer:
    """Mass inside the sphere, in 1/256 level."""
    if scheme == "cell":
        return truncated(q.astype(f32) * (w * f32(256)) + HALF)
    return np.maximum(0, 256 * q.astype(np.int64) - truncated(p.astype(f32) * ((ONE - w) * f32(256)) + HALF))


def bilinear(table: Float, e: Float, tau: Float) -> Float:
    """The effective depth G(e, tau) from its table of nodes (i/8, j/40) (f32)."""
    te, tt = e * f32(8), tau * f32(40)
    i, j = np.minimum(truncated(te), 23), np.minimum(truncated(tt), 39)
    fe, ft = te - i.astype(f32), tt - j.astype(f32)
    lo = table[i, j] + (table[i, j + 1] - table[i, j]) * ft
    hi = table[i + 1, j] + (table[i + 1, j + 1] - table[i + 1, j]) * ft
    return lo + (hi - lo) * fe


def depth_fraction(
    at: Geometry, q: NDArray[np.uint8], p: NDArray[np.uint8], m256: Integer, radius: float, table: Float
) -> Float:
    """Depth d/R at which `layer` erodes a voxel; without meaning for a voxel without mass (f32)."""
    R, r, w = f32(radius), at.distance, at.coverage
    inv_R = ONE / R
    level = np.where(m256 > 0, p, 1).astype(f32)  # an empty voxel would divide by zero
    tau = np.minimum((m256.astype(f32) * (ONE / (level * f32(256)))) / w, ONE - f32(2.0**-24))
    e = np.maximum(((R - r) * at.inv_width + HALF) - ONE, ZERO)
    beyond = at.deep if at.isotropic else at.deep | (e >= f32(3))
    e = np.minimum(e, f32(3) - f32(2.0**-22))
    return np.where(beyond, (R - r) * inv_R, (w * (at.width * inv_R)) * bilinear(table, e, tau))


def eroded_fraction(f: Float, rate: float) -> Float:
    """1 - exp(-rate f) by a polynomial and k doublings (f32)."""
    k = 0
    while rate * 2.0**-k > 0.125:
        k += 1
    y = f32(rate * 2.0**-k) * f
    P = y * (ONE - y * (f32(0.49999714) - y * (f32(0.16652727) - y * f32(0.03972289))))
    for _ in range(k):
        P = P * (TWO - P)
    return P


def eroded_by_tissue(f: Float, rates: Sequence[float], tissue: NDArray[np.uint8]) -> Float:
    """The eroded fraction of every voxel at the rate of its tissue (f32)."""
    P = np.zeros_like(f)
    for number, rate in enumerate(rates):
        here = tissue == number
        P[here] = eroded_fraction(f[here], rate)
    return P


def loss(expected: Float, u: Integer, v: Integer) -> Integer:
    """Levels lost: the expected loss [2^-16 level], rounded up or down by the draws u and v."""
    T = truncated(expected)
    lo = truncated((expected - T.astype(f32)) * f32(65536) + HALF)
    return ((T + u) >> 16) + (((T + u) & 0xFFFF == 0xFFFF) & (v < lo))


# --- Force ------------------------------------------------------------------------------------------------


def penetration_ratio(m: float) -> float:
    """Smallest positive root u of u^2 (1 - u/3) = m, m in 0..4/3 (Eq. 2)."""
    if m > 2.0 / 3.0:
        return 2.0 - penetration_ratio(4.0 / 3.0 - m)
    a, s = math.sqrt(m) / 3.0, 1.0
    for _ in range(4):
        s = s - (s * s * (1.0 - a * s) - 1.0) / (s * (2.0 - 3.0 * a * s))
    return math.sqrt(m) * s


@dataclass(frozen=True)
class ReferenceTissues:
    """Tissue number of every voxel, and elastic constant [N/mm^2] and erosion rate [1/ms] of each tissue."""

    number: NDArray[np.uint8]
    c_e: Sequence[float]
    alpha: Sequence[float]

    def mean_c_e(self, m256: Integer) -> float:
        """Mean of c_e over a positive mass [N/mm^2]."""
        K = np.array([int(np.rint(4096 * c)) for c in self.c_e])
        S0, S_K = int(m256.sum()), int((K[self.number] * m256).sum())
        return (S_K // S0 + float(S_K % S0) / float(S0)) / 4096


# --- The tick ---------------------------------------------------------------------------------------------


@dataclass
class ReferenceContact:
    """A burr on a voxel bone, of one material or of tissues.

    Parameters
    ----------
    q, p : ndarray of uint8, (nz, ny, nx)
        Present and pristine level, 0..255, q <= p. The arrays are not copied: `step` changes `q` in place.
    spacing : sequence of 3 float, or float
        Voxel size along (x, y, z) [mm].
    origin : sequence of 3 float
        Centre of voxel (0, 0, 0), (x, y, z) [mm].
    radius : float
        Burr radius [mm].
    c_e : float
        Elastic constant [N/mm^2].
    alpha : float
        Erosion rate [1/ms].
    shape_name : str
        Erosion shape: parabolic, linear, quartic, constant or power(k).
    seed : int
        Below 2^64.
    index : int
        Burr index, below 2^31.
    scheme : {'layer', 'cell'}
        Erosion scheme.
    depth_table : ndarray of float32, (25, 41), optional
        Effective depth G(i/8, j/40) of the shape's order; `layer` needs it unless the shape is constant.
    tissues : ReferenceTissues, optional
        By default every voxel has `c_e` and `alpha`.
    force_exponent, rate_exponent : float
        q of |F| = c_e R^2 u^q, m of the rate alpha (|F|/1 N)^m.
    """

    q: NDArray[np.uint8]
    p: NDArray[np.uint8]
    spacing: Sequence[float] | float
    origin: Sequence[float]
    radius: float
    c_e: float
    alpha: float
    shape_name: str
    seed: int
    index: int = 0
    scheme: str = "layer"
    depth_table: Float | None = None
    tissues: ReferenceTissues | None = None
    force_exponent: float = 1.5
    rate_exponent: float = 0.0
    tick: int = field(default=0, init=False)

    def step(self, center: ArrayLike, dt: float, burr_on: bool = True) -> dict[str, object]:
        """Moments, force and erosion of one tick.

        Parameters
        ----------
        center : sequence of 3 float
            Centre of the burr, (x, y, z) [mm].
        dt : float
            Duration of the tick [ms].
        burr_on : bool
            Whether the burr erodes.

        Returns
        -------
        dict
            force [N], c_e [N/mm^2], normal, penetration [mm], m0 [mm^3], m1 [mm^4], removed [mm^3], and the
            flags touching, ambiguous, coarse, faint.
        """
        sx, sy, sz = spacing = tuple(float(s) for s in np.broadcast_to(self.spacing, 3))
        at = geometry(center, self.radius, self.q.shape, spacing, tuple(float(o) for o in self.origin))  # type: ignore[arg-type]
        m256 = mass(self.q, self.p, at.coverage, self.scheme)
        dV = sx * sy * sz

        S0 = int(m256.sum())
        nz, ny, nx = self.q.shape
        S = (
            sum(int(m256[:, :, x].sum()) * (x - int(at.base[0])) for x in range(nx)),
            sum(int(m256[:, y, :].sum()) * (y - int(at.base[1])) for y in range(ny)),
            sum(int(m256[z, :, :].sum()) * (z - int(at.base[2])) for z in range(nz)),
        )
        m0 = S0 * (dV / 65280)
        m1 = [(S[i] - at.frac[i] * S0) * (spacing[i] * (dV / 65280)) for i in range(3)]

        R = self.radius
        h = penetration_ratio(min(m0 / (math.pi * R * R * R), 4.0 / 3.0)) * R
        length = math.sqrt(m1[0] * m1[0] + m1[1] * m1[1] + m1[2] * m1[2])
        floor = 0.1 * m0 * R
        normal = np.zeros(3) if S0 == 0 else -np.array(m1) / max(length, floor)
        c_e = self.c_e if self.tissues is None or S0 == 0 else self.tissues.mean_c_e(m256)
        u, q, m = h / R, self.force_exponent, self.rate_exponent
        magnitude = c_e * R * R * (u * math.sqrt(u) if q == 1.5 else portable_power(u, q))
        factor = 1.0 if m == 0.0 else portable_power(magnitude, m)

        faint_mass = int(m256[(self.p > 0) & (self.p < 32)].sum())
        dropped = self._erode(at, m256, dt, factor) if burr_on else 0
        self.tick = (self.tick + 1) % 2**64
        return {
            "force": magnitude * normal,
            "c_e": c_e,
            "normal": normal,
            "penetration": h,
            "m0": m0,
            "m1": np.array(m1),
            "removed": dropped * (dV / 255),
            "touching": S0 > 0,
            "ambiguous": S0 > 0 and length < floor,
            "coarse": R / max(spacing) < 7.5,
            "faint": self.scheme == "layer" and 20 * faint_mass > S0,
        }

    def expected_loss(self, at: Geometry, m256: Integer, dt: float, factor: float = 1.0) -> Float:
        """Expected loss lambda of every voxel [2^-16 level] (f32)."""
        shape = ReferenceShape(self.shape_name)
        inv_R = ONE / f32(self.radius)
        x2 = at.distance2 * (inv_R * inv_R)
        if self.scheme == "cell":
            f = shape.at_radius(at.distance * inv_R, x2)
        elif shape.base == "one":
            f = np.ones_like(at.distance)
        else:
            depth = depth_fraction(at, self.q, self.p, m256, self.radius, self.depth_table)
            f = shape.at_depth(depth, at.deep, x2)
        e256 = np.where(m256 > 0, 256 * self.q.astype(np.int64), 0) if self.scheme == "cell" else m256
        one_material = ReferenceTissues(np.zeros_like(self.q), [self.c_e], [self.alpha])
        tissues = one_material if self.tissues is None else self.tissues
        rates = [min(alpha * dt * factor, 1000.0) for alpha in tissues.alpha]
        lam = (e256.astype(f32) * f32(2.0**8)) * eroded_by_tissue(f, rates, tissues.number)
        if lam.dtype != f32:
            raise AssertionError("a Python float or a double has slipped into the single-precision part")
        return lam

    def _erode(self, at: Geometry, m256: Integer, dt: float, factor: float) -> int:
        lam = self.expected_loss(at, m256, dt, factor)
        u, v = (draw_lanes(self.q.shape, self.seed, self.tick, self.index, draw) for draw in (0, 1))
        drop = loss(lam, u, v)
        if np.any(drop > self.q):
            raise AssertionError("a voxel would lose more than it holds")
        self.q -= drop.astype(np.uint8)
        return int(drop.sum())
