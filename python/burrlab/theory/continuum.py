"""The descent in the continuum: Eqs. 2 to 4 without voxels, and the master curve of all descents.

v = alpha R Psi(phi, window; f) with phi = F/(c_e R^2): one curve for each erosion shape f and window. It serves every
`Law`, as force and rate are constant in a descent.

References
----------
Agus et al., Physics-based burr haptic simulation: tuning and evaluation, HAPTICS 2004.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeAlias, TypeVar

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

import burrlab._core as _core
from burrlab._core import Burr, Material, Shape
from burrlab.common.check import real, refuse, scalar
from burrlab.common.figures import POSITION, Axes, axes_or_new, drawing, styled
from burrlab.theory.tool import PAPER_LAW, law_of, require_tool

Floats: TypeAlias = NDArray[np.float64]
Number = TypeVar("Number", Floats, float, Floats | float)

WINDOW_START, WINDOW_STOP = 1 / 6, 1 / 3  # default window [R]; it starts at static contact if that is deeper
PER_SECOND = 1e3  # alpha is per ms
PAPER_FORCE_EXPONENT = PAPER_LAW["force_exponent"]  # q of Eq. 3


@dataclass(frozen=True)
class Law:
    """How force and erosion grow: F = c_e R^2 u^q and d rho/dt = -alpha (F/1 N)^m f rho, with u = h/R.

    The paper's law has q = 3/2 and m = 0 (Eqs. 3, 4). At small forces v ~ F^slope, and velocities tell
    alpha/c_e^ridge_exponent (docs/model.md, "Other laws").

    Parameters
    ----------
    shape : Shape or str
        Erosion shape function f.
    force_exponent, rate_exponent : float
        q >= 1 and m >= 0; `Material` has both too.

    Raises
    ------
    ValueError
        If an exponent is out of range or the shape unknown.

    Examples
    --------
    >>> import burrlab
    >>> paper, kobra = burrlab.Law(), burrlab.Law("parabolic", 2, 1)
    >>> str(paper), str(kobra), round(paper.slope, 3), kobra.slope
    ('parabolic', 'parabolic, F ~ h^2, rate ~ F^1', 2.667, 3.0)
    """

    shape: Shape
    force_exponent: float
    rate_exponent: float

    def __init__(
        self,
        shape: Shape | str = "parabolic",
        force_exponent: float = PAPER_FORCE_EXPONENT,
        rate_exponent: float = 0.0,
    ) -> None:
        material = Material(  # which checks all three
            c_e=1.0, alpha=0.1, shape=shape, force_exponent=force_exponent, rate_exponent=rate_exponent
        )
        vars(self).update({name: getattr(material, name) for name in ("shape", *PAPER_LAW)})

    @classmethod
    def of(cls, law: "Law | Material | Shape | str") -> "Law":
        """A law, that of a material, or the paper's with another f."""
        refuse(
            not isinstance(law, Law | Material | Shape | str),
            f"law must be a Law, a Shape or the name of one: got {law!r}",
            TypeError,
        )
        if isinstance(law, Material):
            return cls(law.shape, law.force_exponent, law.rate_exponent)
        return law if isinstance(law, Law) else cls(law)

    def material(self, c_e: float, alpha: float, name: str = "unnamed", source: str = "") -> Material:
        """A material of this law."""
        return Material(
            name, c_e=c_e, alpha=alpha, shape=self.shape, source=source, force_exponent=self.force_exponent,
            rate_exponent=self.rate_exponent,
        )  # fmt: skip

    def velocity(
        self, force: Floats | float, c_e: Floats | float, alpha: Floats | float, radius: float,
        start: float | None = None, stop: float | None = None,
    ) -> np.float64 | Floats:  # fmt: skip
        """v = alpha (F/1 N)^m R Psi((F/(c_e R^2))^(3/(2q))) [mm/s], over a window [R]; see `MasterCurve`."""
        ratio = MasterCurve(self.shape).velocity_ratio(
            self.master_phi(force / (c_e * radius**2)), start, stop
        )
        return np.asarray(PER_SECOND * alpha * radius * ratio * rate_factor(force, self.rate_exponent))[()]

    def master_phi(self, phi: Number) -> Number:
        """phi^(3/(2q)), at which the master curve, made with q = 3/2, has the same depth u = phi^(1/q)."""
        return phi if self.force_exponent == PAPER_FORCE_EXPONENT else phi**self.stretch

    @property
    def stretch(self) -> float:
        """3/(2q), by which log phi is stretched on the master curve."""
        return PAPER_FORCE_EXPONENT / self.force_exponent

    @property
    def is_paper(self) -> bool:
        """Whether both exponents are the paper's."""
        return not self.exponents

    @property
    def exponents(self) -> dict[str, Any]:
        """The exponents that are not the paper's, by their names, as files and provenance hold them."""
        return law_of(self)

    @property
    def ridge_exponent(self) -> float:
        """p = 2 (k + 1)/q of alpha/c_e^p, which small forces determine; k is the order of f's zero at r = R."""
        return 2 * (self.shape.order + 1) / self.force_exponent

    @property
    def slope(self) -> float:
        """s = p + m of v ~ F^s at small forces."""
        return self.ridge_exponent + self.rate_exponent

    def __str__(self) -> str:
        force = f", F ~ h^{self.force_exponent:.4g}" if self.force_exponent != PAPER_FORCE_EXPONENT else ""
        return (
            self.shape.label + force + (f", rate ~ F^{self.rate_exponent:.4g}" if self.rate_exponent else "")
        )


def rate_factor(force: Floats | float, rate_exponent: float) -> Floats | float:
    """(F/1 N)^m, by which the rate grows with the force."""
    return force**rate_exponent if rate_exponent else 1.0


@dataclass(frozen=True, eq=False, repr=False)
class MeanFieldDescent:
    """One descent at constant force, from static contact to the stop.

    Attributes
    ----------
    time : ndarray, shape (n,)
        [s], from 0; read-only.
    immersion : ndarray, shape (n,)
        Depth H of the burr's tip [mm], rising; read-only. H is linear in time between points.
    burr, material, force, resolution
        As given to `mean_field_descent`; force in N.
    """

    time: Floats
    immersion: Floats
    burr: Burr
    material: Material
    force: float
    resolution: float

    def window(self, start_mm: float | None = None, stop_mm: float | None = None) -> tuple[float, float]:
        """Window [mm] that `velocity` uses; default max(R/6, static immersion) .. R/3.

        It never starts before static contact. If its end is not above its start there is no window.
        """
        start = WINDOW_START * self.burr.radius if start_mm is None else float(start_mm)
        stop = WINDOW_STOP * self.burr.radius if stop_mm is None else float(stop_mm)
        return max(start, float(self.immersion[0])), stop

    def velocity(self, start_mm: float | None = None, stop_mm: float | None = None) -> float:
        """Penetration velocity [mm/s]: least-squares slope of immersion over time in the window.

        Parameters
        ----------
        start_mm, stop_mm : float, optional
            See `window`.

        Returns
        -------
        float
            [mm/s]; NaN if static contact is beyond the window.

        Raises
        ------
        ValueError
            If the window is not in order or ends beyond the descent.
        """
        start, stop = self.window(start_mm, stop_mm)
        check_window(None if start_mm is None else start_mm / self.burr.radius, stop / self.burr.radius)
        end = float(self.immersion[-1])
        refuse(
            stop > end * (1 + 1e-9),
            f"stop_mm must not lie beyond the descent's end, {end:g} mm, got {stop:g}",
        )
        return (
            float("nan")
            if start >= stop
            else _core.window_velocity(self.time, self.immersion, start, min(stop, end))
        )

    @drawing
    def plot(self, ax: "Axes | None" = None, **style: Any) -> "Axes":
        """Draws immersion over time; returns the Axes. `style`: label, color and so on of the line."""
        ax = axes_or_new(ax)
        ax.plot(
            self.time,
            self.immersion,
            **styled(style, color=POSITION, label=f"{self.material.name}, {self.force:g} N, mean-field"),
        )
        ax.set(xlabel="time [s]", ylabel="immersion [mm]")
        return ax

    def __repr__(self) -> str:
        return (
            f"MeanFieldDescent({self.material.name}, R = {self.burr.radius:g} mm, {self.force:g} N: "
            f"{self.immersion[0]:.3g}..{self.immersion[-1]:.3g} mm in {self.time[-1]:.3g} s)"
        )


def mean_field_descent(
    burr: Burr, material: Material, force: float, *, stop: float | None = None, resolution: float = 1.0
) -> MeanFieldDescent:
    """The descent of a burr along its axis into solid bone at constant force.

    Density depends on depth and lateral radius only. Each step finds the time at which the bone left in the
    burr, eroding by Eq. 4, has the mass that balances the force (Eqs. 2 and 3).

    Parameters
    ----------
    burr : Burr
    material : Material
    force : float
        F [N], below c_e R^2 (stop/R)^q; q = 1.5 in Eq. 3.
    stop : float, optional
        Immersion at the end of the descent [mm], up to R; default R/3.
    resolution : float
        Factor of the number of steps; the error falls with its square.

    Returns
    -------
    MeanFieldDescent

    Raises
    ------
    ValueError
        If the force, the resolution or the material's alpha is not positive and finite, stop is not in (0,
        R], static contact alone reaches stop, or the descent takes more than 200 000 steps.

    Notes
    -----
    At resolution 1 the penetration velocity is within 0.1 % of the limit for every f and phi = 0.005..0.19.

    Examples
    --------
    >>> import burrlab
    >>> from burrlab.theory.continuum import mean_field_descent
    >>> descent = mean_field_descent(burrlab.Burr(3.0), burrlab.Material("bone", c_e=2.145, alpha=0.087), 1.0)
    >>> descent
    MeanFieldDescent(bone, R = 3 mm, 1 N: 0.417..1 mm in 0.986 s)
    >>> round(descent.velocity(), 3), descent.window()
    (0.499, (0.5, 1.0))
    """
    require_tool(burr, material)
    R, stop_mm = burr.radius, WINDOW_STOP * burr.radius if stop is None else scalar(stop, "stop")
    force = scalar(positive("force", force), "force")
    positive("alpha of the material", material.alpha)
    refuse(not 0 < stop_mm <= R, f"stop must be above 0 and at most R = {R:g} mm, got {stop_mm:g}")
    unit, q = material.c_e * R**2, material.force_exponent
    limit = unit * (stop_mm / R) ** q
    refuse(
        not force < limit,
        f"force must be below c_e R^2 (stop/R)^{q:.4g} = {limit:.4g} N, or static contact alone reaches the "
        f"stop, got {force:g}",
    )
    phi = Law.of(material).master_phi(force / unit)
    rate = material.alpha * rate_factor(force, material.rate_exponent)
    time, immersion = _core.mean_field_descent(material.shape, phi, stop_mm / R, resolution)
    time, immersion = time / (PER_SECOND * rate), immersion * R
    time.flags.writeable = immersion.flags.writeable = False
    return MeanFieldDescent(time, immersion, burr, material, force, float(resolution))


def thin_layer_velocity(
    burr: Burr, material: Material, force: ArrayLike, immersion: ArrayLike
) -> np.float64 | Floats:
    r"""Velocity at an immersion for a thin eroding layer: the limit of small forces.

    With f = kappa ((R - r)/R)^k + ... near r = R, b = (k + 2)/(k + 1) and u = phi^(1/q),

    .. math::

       v = \frac{\kappa \alpha\, (F/1\,\mathrm N)^m R}{k + 1} \left[\frac{b\, u^2 (1 - u/3)}
       {2 \Gamma(b) \left(1 - (1 - H/R)^b\right)}\right]^{k + 1},

    so v ~ F^(2(k+1)/q + m): F^(4(k+1)/3) by Eqs. 3 and 4, q = 3/2 and m = 0. k = 1 is the law of a parabolic (kappa = 2) or linear (kappa = 1) f; power(k) has
    kappa = 2^k. For constant f, k = 0, the law is exact.

    Parameters
    ----------
    burr : Burr
    material : Material
    force : array_like
        F [N], above 0.
    immersion : array_like
        H [mm], above 0 and up to R.

    Returns
    -------
    ndarray, shape of force and immersion broadcast
        [mm/s]

    Raises
    ------
    ValueError
        If a force is not positive and finite, or an immersion is out of range.

    Notes
    -----
    A column of bone that the front meets at slope cos(theta) has rho = exp(-int f dy/v), with y the height
    above the front. The mass of all columns of the immersed cap must be that of Eq. 2. For parabolic f the
    penetration velocity over R/6 .. R/3 is 2.0 % above this law at phi = 0.025 and 0.2 % above it at 0.005.

    Examples
    --------
    >>> import burrlab
    >>> from burrlab.theory.continuum import thin_layer_velocity
    >>> bone = burrlab.Material("bone", c_e=2.145, alpha=0.087)
    >>> thin_layer_velocity(burrlab.Burr(3.0), bone, 0.1, [0.5, 1.0]).round(5)
    array([0.00257, 0.00071])
    """
    require_tool(burr, material)
    R, force = burr.radius, positive("force", force)
    phi = Law.of(material).master_phi(force / (material.c_e * R**2))
    depth = real(immersion, "immersion")
    inside = (depth > 0) & (depth <= R)
    refuse(not inside.all(), f"immersion must be above 0 and at most R = {R:g} mm, got {immersion!r}")
    velocity: Floats = np.asarray(_core.thin_layer_velocity(material.shape, phi, depth / R))
    return PER_SECOND * material.alpha * R * velocity * rate_factor(force, material.rate_exponent)


def positive(name: str, values: ArrayLike) -> Floats:
    """`values` as an array; ValueError unless all are positive and finite."""
    array = real(values, name)
    if not ((array > 0) & (array < np.inf)).all():
        raise ValueError(f"{name} must be positive and finite, got {values!r}")
    return array


def check_window(start: float | None, stop: float | None) -> tuple[float, float]:
    """Window ends [R], the default ones for None; ValueError unless in order and within R."""
    low, high = WINDOW_START if start is None else float(start), WINDOW_STOP if stop is None else float(stop)
    refuse(
        not 0 <= low < high <= 1,
        f"window must have 0 <= start < stop <= R, got {low:.6g} R to {high:.6g} R",
    )
    return low, high


_Knot: TypeAlias = tuple[float, Floats, Floats]  # phi, time [1/alpha], immersion [R]
_LOWEST = 0.02  # phi/stop^1.5 of the lowest knot from a descent; below it the thin-layer law holds
_KNOTS = 24  # descents shared by all windows, evenly spaced in log phi
_GAP = 1e-4  # gap between the last knot and the phi where the window vanishes [spline's range]


class MasterCurve:
    """Psi(phi) = v/(alpha R): penetration velocity against phi = F/(c_e R^2) for one erosion shape.

    For each window, log Psi over log phi is a cubic spline on either side of a kink at phi = start^1.5, which
    is a knot; above it the window begins at static contact. At phi = stop^1.5 the window vanishes. Below 0.02
    stop^1.5 the thin-layer law continues the curve, times a correction that fits the lowest knot. `start` and
    `stop` are in units of R; default max(1/6, phi^(2/3)) .. 1/3.

    Parameters
    ----------
    shape : Shape or str
        Erosion shape function f, or its name.

    Notes
    -----
    The curve is within 0.2 % of single descents at any phi. Most knots are descents whose H(t) serve every
    window: they are made once per shape and process. Splines are made once per window, in tens of
    milliseconds (tenths of a second if k is not whole).

    Examples
    --------
    >>> from burrlab.theory.continuum import MasterCurve
    >>> curve = MasterCurve("parabolic")
    >>> ["%.3e" % ratio for ratio in curve.velocity_ratio([0.025, 0.05, 0.1, 0.2])]
    ['2.744e-04', '1.740e-03', '9.975e-03', 'nan']
    >>> curve.local_slope([1e-4, 0.06, 0.07]).round(2)
    array([2.67, 2.72, 2.44])
    """

    def __init__(self, shape: Shape | str) -> None:
        self.shape = Shape(shape)

    def velocity_ratio(
        self, phi: ArrayLike, start: float | None = None, stop: float | None = None
    ) -> np.float64 | Floats:
        """Psi = v/(alpha R) at phi = F/(c_e R^2).

        Parameters
        ----------
        phi : array_like
            Above 0.
        start, stop : float, optional
            Window [R], 0 <= start < stop <= 1.

        Returns
        -------
        ndarray of the shape of phi
            NaN for phi >= stop^1.5, where static contact alone reaches the window's end.

        Raises
        ------
        ValueError
            If a phi is not positive or the window is not in order.
        """
        spline = _window_spline(self.shape.name, start, stop)
        phi = positive("phi", phi)
        ratio = np.exp(spline.log_ratio(np.log(np.minimum(phi, spline.end))))
        return np.where(phi < spline.end, ratio, np.nan)[()]

    def log_velocity_ratio(
        self, log_phi: Floats, start: float | None = None, stop: float | None = None
    ) -> Floats:
        """log Psi at log phi, for tables of many; see `velocity_ratio`."""
        spline = _window_spline(self.shape.name, start, stop)
        log_ratio: Floats = spline.log_ratio(log_phi)
        log_ratio[log_phi >= np.log(spline.end)] = np.nan
        return log_ratio

    def local_slope(
        self, phi: ArrayLike, start: float | None = None, stop: float | None = None
    ) -> np.float64 | Floats:
        """d log Psi/d log phi, the local exponent of v ~ F^n; at the kink, its value to the right.

        Parameters, NaN and errors as `velocity_ratio`.
        """
        spline = _window_spline(self.shape.name, start, stop)
        phi = positive("phi", phi)
        return np.where(phi < spline.end, spline.slope(np.log(np.minimum(phi, spline.end))), np.nan)[()]

    def __repr__(self) -> str:
        return f"MasterCurve({self.shape.label!r})"


def penetration_velocity(
    burr: Burr,
    material: Material,
    force: ArrayLike,
    start_mm: float | None = None,
    stop_mm: float | None = None,
) -> np.float64 | Floats:
    """Penetration velocity v = alpha R Psi(F/(c_e R^2)) from the master curve of the material's shape.

    Of another `Law` it is v = alpha (F/1 N)^m R Psi((F/(c_e R^2))^(3/(2q))).

    Parameters
    ----------
    burr : Burr
    material : Material
    force : array_like
        F [N], above 0.
    start_mm, stop_mm : float, optional
        Window [mm]; default max(R/6, static immersion) .. R/3. It never starts before static contact.

    Returns
    -------
    ndarray of the shape of force
        [mm/s]; NaN where static contact is beyond the window.

    Raises
    ------
    ValueError
        If a force is not positive and finite, or the window is not in order and within R.

    Examples
    --------
    >>> import burrlab
    >>> from burrlab.theory.continuum import penetration_velocity
    >>> bone = burrlab.Material("bone", c_e=2.145, alpha=0.087)
    >>> penetration_velocity(burrlab.Burr(3.0), bone, [0.3, 0.5, 1.0, 2.0]).round(4)
    array([0.0203, 0.0787, 0.4994, 2.8161])
    """
    require_tool(burr, material)
    return Law.of(material).velocity(
        positive("force", force),
        material.c_e,
        material.alpha,
        burr.radius,
        *[None if end is None else end / burr.radius for end in (start_mm, stop_mm)],
    )


@dataclass(frozen=True)
class _WindowSpline:
    """log Psi over log phi for one window, linear below the first break; `end` is phi = stop^1.5."""

    end: float
    log_ratio: scipy.interpolate.PPoly
    slope: scipy.interpolate.PPoly


@lru_cache(maxsize=64)
def _knots(shape: str, reach: float) -> list[_Knot]:
    """Descents to immersion `reach`, by rising phi."""
    return _descents(shape, reach**1.5 * np.geomspace(_LOWEST, 1, _KNOTS, endpoint=False), reach)


def _descents(shape: str, phis: Floats, stop: float) -> list[_Knot]:
    """Descents to `stop`, side by side: the core lets other threads of Python run."""
    with ThreadPoolExecutor() as pool:
        return list(
            pool.map(lambda phi: (phi, *_core.mean_field_descent(Shape(shape), phi, stop)), phis.tolist())
        )


@lru_cache(maxsize=4096)
def _window_spline(shape: str, start: float | None, stop: float | None) -> _WindowSpline:
    start, stop = check_window(start, stop)
    kink, end = start**1.5, stop**1.5
    low = _LOWEST * end
    if kink <= 1.01 * low:
        poly = _branch(shape, low, end, start, stop)
    else:
        left, right = _branch(shape, low, kink, start, stop), _branch(shape, kink, end, start, stop)
        poly = scipy.interpolate.PPoly(np.hstack([left.c, right.c]), np.concatenate([left.x, right.x[1:]]))
    # a straight line as the first piece, which PPoly extrapolates
    value, slope = float(poly(poly.x[0])), float(poly(poly.x[0], 1))
    first = np.array([[0.0], [0.0], [slope], [value - slope]])
    poly = scipy.interpolate.PPoly(np.hstack([first, poly.c]), np.concatenate([[poly.x[0] - 1], poly.x]))
    return _WindowSpline(end, poly, poly.derivative())


def _branch(shape: str, low: float, high: float, start: float, stop: float) -> scipy.interpolate.PPoly:
    """Spline from phi = low to high; left of the kink the thin-layer law continues it to smaller phi.

    Knots in the middle are descents shared by all windows. Both ends have their own knots, more of them close
    to `high`: there the window begins in the first transient, and log Psi bends on a scale of 1/k.
    """
    reach = min(1.0, 1.5 ** np.ceil(np.log(3 * stop) / np.log(1.5) - 1e-9) / 3)
    top = high - _GAP * (high - low) if high == stop**1.5 else high
    bend = high * (1 - 0.25 * np.geomspace(1, 1 / 64, 7 + round(Shape(shape).order)))
    knots = _descents(shape, np.array([low, *bend[bend > low], top]), stop)
    knots += [knot for knot in _knots(shape, reach) if low * 1.03 < knot[0] < high * 0.73]
    knots.sort(key=lambda knot: knot[0])
    x = np.log([phi for phi, _, _ in knots])
    y = np.log([_core.window_velocity(t, H, max(start, H[0]), min(stop, H[-1])) for _, t, H in knots])
    if high <= start**1.5:
        smaller = low * np.geomspace(1e-3, 1, 24, endpoint=False)
        y = np.append(y[0] + _log_thin_ratio(shape, smaller, low, y[0], start, stop), y)
        x = np.append(np.log(smaller), x)
    return scipy.interpolate.CubicSpline(x, y)


def _log_thin_ratio(shape: str, phi: Floats, low: float, y: float, start: float, stop: float) -> Floats:
    """log Psi(phi) - log Psi(low) for phi < low, where Psi(low) = exp(y).

    It is the thin-layer law, a power of Eq. 2's mass in a fixed window, times a correction that fits Psi(low)
    and is linear in the layer's thickness, ~ phi^(4/3).
    """
    f = Shape(shape)
    H = np.linspace(start, stop, 1000)
    slowness = 1 / np.asarray(_core.thin_layer_velocity(f, low, H))
    time = np.append(0, np.cumsum((slowness[1:] + slowness[:-1]) / 2 * np.diff(H)))
    excess = np.exp(y) / _core.window_velocity(time, H, start, stop) - 1
    u, u_low = phi ** (2 / 3), low ** (2 / 3)
    mass = u**2 * (1 - u / 3) / (u_low**2 * (1 - u_low / 3))
    return np.asarray((f.order + 1) * np.log(mass) + np.log((1 + excess * (u / u_low) ** 2) / (1 + excess)))
