"""The next measurement: which candidate is expected to shrink the joint region of c_e and alpha most."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import burrlab.common.table as table
from burrlab.common.check import refuse, require_type, scalar, seed_or_new, whole
from burrlab.common.figures import REFERENCE, Axes, axes_or_new, drawing, styled
from burrlab.common.progress import Progress, counter
from burrlab.common.provenance import provenance
from burrlab.common.records import Codec
from burrlab.comparing.laws import rise_of
from burrlab.fitting.likelihood import MODEL_ERROR
from burrlab.fitting.observations import Floats, Rows
from burrlab.fitting.result import Fit
from burrlab.fitting.verdict import SEPARATE
from burrlab.planning.region import NewData, RegionGrid, SharedOffsets, with_new_level
from burrlab.theory.continuum import WINDOW_START, WINDOW_STOP, MasterCurve

_END = 0.99 * WINDOW_STOP**1.5  # phi close to which a window ends
_SHOWN = 8  # rows of the repr
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe and Ito's palette
_MARKERS = "osD^v<"


@dataclass(frozen=True)
class Candidate:
    """A measurement that could be made, and what is expected of it."""

    kind: str  #: "velocity" or "static"
    force: float | None  #: F of a velocity [N]
    depth: float | None  #: h of a static pair [mm]
    radius: float  #: R [mm]
    n: int  #: repeats
    area_ratio: float  #: area of the joint 95 % region, new over old; geometric mean over the truths
    probability: float  #: that c_e is then separately identified: closed 95 % interval within a factor of 2
    c_e_ratio: float  #: upper over lower end of that interval, median over the truths; infinite where open
    overloaded: float  #: probability that static contact passes R/3: the run only bounds c_e from above
    #: rise of AIC of the fit `against` over the fit, if the fit's law holds; None where that leaves no window
    parting: float | None = None


@dataclass(frozen=True, repr=False)
class Design:
    """Candidates for the next measurement, the one that shrinks the joint region most first.

    Made by `burrlab.design`.

    Attributes
    ----------
    rows : tuple of Candidate
        By rising area ratio, or with `against` by falling `parting`; equal ones in the order of the request.
    scatter : float
        Standard deviation of ln v of the new velocities.
    static_scatter : float or None
        Standard deviation of ln F of the new static pairs; None without such candidates.
    truths : int
        Number of (c_e, alpha) that the means and probabilities are taken over.
    c_e_end : float
        Upper end of c_e [N/mm^2]: the area of an open region is counted up to here, and no truth lies beyond.
    open_above : bool
        Whether the joint 95 % region of the fit is open above, and so cut off at `c_e_end`.
    seed : int
        Seed of the truths.
    provenance : dict
        Package version, arguments and platform.
    """

    rows: tuple[Candidate, ...]
    scatter: float
    static_scatter: float | None
    truths: int
    c_e_end: float
    open_above: bool
    seed: int
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def best(self) -> Candidate:
        """The first row."""
        return self.rows[0]

    def _columns(self, rows: Sequence[Candidate]) -> dict[str, list[str]]:
        columns = dict(zip(_HEADS, map(list, zip(*map(_cells, rows), strict=True)), strict=True))
        if all(candidate.parting is None for candidate in self.rows):
            del columns["AIC apart"]
        return columns

    def __repr__(self) -> str:
        lines = table.table_lines([("", *column) for column in self._columns(self.rows[:_SHOWN]).items()])
        if len(self.rows) > _SHOWN:
            lines.append(f"and {len(self.rows) - _SHOWN} more")
        return "\n".join([self._title(), *lines])

    def _repr_html_(self) -> str:
        return table.html_table(self._title(), self._columns(self.rows))

    def _title(self) -> str:
        many = len(self.rows)
        cut = f", now open, counted up to c_e = {self.c_e_end:.4g} N/mm^2" if self.open_above else ""
        return (
            f"Design: {many} candidate{'s' if many > 1 else ''} of {_repeats(self.best.n)}; area of "
            f"the joint 95 % region{cut}, expected over {self.truths} truths{' up to there' if self.open_above else ''}"
        )

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain Python objects, ready for JSON; an open interval's ratio is None."""
        return dict(Codec().plain(self))

    @drawing
    def plot(self, ax: Axes | None = None, *, label: str | None = None, **style: Any) -> Axes:
        """Area ratio over force, one line per radius; static candidates as dashed lines.

        Static candidates share a line, as their depth does not matter, unless the fit has offsets. A hollow mark
        is a run that is more likely overloaded than not.

        Parameters
        ----------
        label : str, optional
            Said before each radius.
        **style
            `color` and other properties of the lines and marks.
        """
        ax = axes_or_new(ax)
        velocities = [candidate for candidate in self.rows if candidate.force is not None]
        for i, R in enumerate(sorted({candidate.radius for candidate in velocities})):
            line = sorted(
                (candidate.force, candidate.area_ratio, candidate.overloaded)
                for candidate in velocities
                if candidate.radius == R
            )
            force, ratio, overloaded = (np.array(column) for column in zip(*line, strict=True))
            colour, marker = _COLOURS[i % len(_COLOURS)], _MARKERS[i % len(_MARKERS)]
            look = styled(style, color=colour, marker=marker, linewidth=1.2, markersize=4.5)
            ax.plot(force, ratio, **(look | {"marker": ""}))
            likely = overloaded > 0.5
            text: str | None = f"{label or 'velocity'}, $R$ = {R:g} mm"
            for rows, face in ((~likely, look["color"]), (likely, "white")):
                if rows.any():
                    ax.plot(force[rows], ratio[rows], label=text, **(look | {"linestyle": "", "mfc": face}))
                    text = None
        if any(candidate.overloaded > 0.5 for candidate in velocities):
            ax.plot(
                [], [], "o", color=REFERENCE, mfc="white", mew=1.0, ms=4.5, label="more likely overloaded"
            )
        for i, area in enumerate(sorted({row.area_ratio for row in self.rows if row.force is None})):
            text = None if i else "static pairs"
            ax.axhline(area, color=REFERENCE, linewidth=1.2, linestyle="--", label=text)
        ax.axhline(1.0, color=REFERENCE, linewidth=0.8, linestyle=":")
        ax.set(
            xlabel="force [N]",
            ylabel="area of the 95 % region, new / old [1]",
            ylim=(0, 1.08 * max(max(candidate.area_ratio for candidate in self.rows), 1.0)),
        )
        if not velocities:
            ax.set_xticks([])
        ax.legend(title=_repeats(self.best.n))
        return ax


_HEADS = (
    "kind",
    "force [N]",
    "depth [mm]",
    "R [mm]",
    "area ratio",
    "P(separate)",
    "c_e hi/lo",
    "P(overloaded)",
    "AIC apart",
)


def _repeats(n: int) -> str:
    return f"{n} repeat{'s' if n > 1 else ''}"


def _cells(candidate: Candidate) -> list[str]:
    return [
        candidate.kind,
        *("" if x is None else f"{x:g}" for x in (candidate.force, candidate.depth, candidate.radius)),
        f"{candidate.area_ratio:.2f}",
        f"{candidate.probability:.2f}",
        "open" if np.isinf(candidate.c_e_ratio) else f"{candidate.c_e_ratio:.3g}",
        f"{candidate.overloaded:.2f}",
        "" if candidate.parting is None else f"{candidate.parting:.3g}",
    ]


_STATIC_SCATTER = 0.1  # of the log of a static force, where the fit has no indentation (ours)


def design(
    fit: Fit,
    forces: ArrayLike,
    radii: ArrayLike,
    n: int,
    *,
    static: ArrayLike | None = None,
    static_radius: float | None = None,
    scatter: float | None = None,
    static_scatter: float | None = None,
    truths: int = 100,
    against: Fit | None = None,
    seed: int | None = None,
    progress: Progress | None = None,
) -> Design:
    r"""Rank candidates for the next measurement by how far they shrink the joint region of c_e and alpha.

    .. math::

       \text{area ratio} = \exp \left\langle \ln \frac{A_\text{new}}{A_\text{old}} \right\rangle

    with the areas A of the 95 % region in (log c_e, log alpha), the mean over parameters that agree with the data measured so far.

    Parameters
    ----------
    fit : Fit
        The fit to what was measured.
    forces, radii : array_like
        F [N] and burr radii R [mm]. Every pair is a candidate: n velocities over the default window. Either
        may be empty.
    n : int
        Repeats of each candidate.
    static : array_like, optional
        Depths h [mm] below 2R, each a candidate: n pairs of force and depth of the burr at rest (Eq. 3).
    static_radius : float, optional
        Burr radius of the static pairs [mm]; that of the fit by default.
    scatter : float, optional
        Standard deviation of ln v of the new velocities: 0.08 is 8 %. That of the fit by default.
    static_scatter : float, optional
        Standard deviation of ln F of the new pairs. That of the fit's indentation by default, 0.1 where it
        has none.
    truths : int
        Number of (c_e, alpha) that the mean is taken over.
    against : Fit, optional
        A fit of the same data by another law: velocities that tell the two laws apart come first.
    seed : int, optional
        Seed of their draw; None draws a seed, which the result records.
    progress : callable or True, optional
        Called with the fraction done, 0 to 1; True shows a bar on standard error.

    Returns
    -------
    Design
        Best candidate first.

    Raises
    ------
    TypeError
        If fit is no `Fit`.
    ValueError
        If there is no candidate; a force, radius or scatter is not positive and finite; a depth is not above
        0 and below 2R; n or truths is below 1 (n below 2 for the first static pairs); the fit failed;
        `static_radius` is missing after data of several radii; or `scatter` is missing after residuals other
        than ``"relative"``.

    Notes
    -----
    Truths are drawn within the 99.7 % region with weight exp(-rise/2), flat in log c_e and log alpha; the
    rise is that of -2 log L with its scatter profiled out. An open region, and the truths, end at the upper
    bound of c_e in the fit's search, 100 times the lower one; ``fit(bounds={"c_e": ...})`` sets another. Most
    truths are then stiffer than a bone whose c_e is near the lower one: of it, large forces tell far more than
    the mean over all truths says. At each truth the candidate has its expected outcome: a velocity by the
    scaling law (whatever the engine of the fit), a static force by Eq. 3, or ``overloaded`` where static
    contact passes R/3. Then

    .. math::

       -2 \ln L_\text{new}(\theta) = -2 \ln L(\theta) + n\, (\mu(\theta) - \mu(\text{truth}))^2/\text{scatter}^2

    where mu is the log of the outcome. A window bounds c_e from below, an overloaded run from above. The
    region keeps its limit: what more data say about the scatter is left out. The first static pairs have a
    scatter of their own, estimated from the n alone, and its limit. After a fit with days or specimens the new
    data are of a new one, whose mean differs by the standard deviations of the fit. It brings a degree of freedom:
    the limit is that of the rows with one level more, at these deviations. After a fit with offsets the new data
    share them: given c_e and alpha, an offset has the mean and variance that the old rows leave, and both enter
    the expected outcome, linear about the offsets of the fit. So a candidate may rank high because it tells an
    offset. An offset by day or data set is drawn anew, as is the radius of another burr; a drift with the order
    goes on from the last run.

    In simulations with new fits, up to a third more rows after 12 or more give this area within 10 %. More
    new rows, or fewer old ones, give a smaller area: 10 after 4 give two thirds of it. The order of
    candidates is the same. Where days differ by 10 %, the median area of new fits with one day more is within 6 %
    of this one (docs/inference.md). The scatter of the outcome itself is left out, so a probability near 0 or 1 is
    less certain than it looks. An area ratio above 1 is possible: the expected outcomes then undo a limit that the
    old data set by chance, or the fit puts days nearly alike, and many runs of one new day would show how little
    it knows of them, as new fits do. The Fisher information at the fit would not serve: the region may be open,
    and the model has a kink at phi = 0.068.

    With log-normal scatter, and without offsets, a static pair says the same about c_e at any depth and radius.

    References
    ----------
    Chaloner and Verdinelli, Bayesian experimental design: a review, Statistical Science 10 (1995).

    Examples
    --------
    >>> import burrlab
    >>> burr, bone = burrlab.Burr(3.0), burrlab.materials["bone"]
    >>> curve = burrlab.synthetic_curve(burr, bone, [0.3, 0.4, 0.5, 0.6], seed=1)
    >>> plan = burrlab.design(burrlab.fit(curve), [0.4, 3.0], 3.0, 3)
    >>> plan.best.force
    3.0
    """
    require_type("fit", fit, Fit, "burrlab.fit(curve)")
    fit._evidence()
    force, radius = _positive("forces", forces, " N"), _positive("radii", radii, " mm")
    depth, static_radius = _depths(fit, static, static_radius)
    if against is not None:
        require_type("against", against, Fit, "burrlab.fit(curve, law='quartic')")
        refuse(against.law == fit.law, f"against must be of another law: got {fit.law} twice")
    refuse(
        not len(force) * len(radius) + len(depth),
        "forces and radii, or static, must hold a candidate: got none",
    )
    for name, number in (("n", n), ("truths", truths)):
        refuse(whole(name, number, 10**6, "1e6") < 1, f"{name} must be at least 1: got {number!r}")
    first = not (len(fit.observations.pressed) or fit.likelihood.known)
    refuse(
        len(depth) and first and n < 2,
        f"n must be at least 2 for the first static pairs, to show their scatter: got {n!r}",
    )
    scatter = _scatter(fit, scatter)
    static_scatter = _static_scatter(fit, static_scatter)
    seed = seed_or_new(seed)
    report_progress, total = counter(progress, "candidates"), len(radius) * len(force) + len(depth)

    law, curve = fit.law, MasterCurve(fit.shape)
    phi = law.master_phi(force / (fit.c_e * radius[:, None] ** 2))
    # of ln v by ln c_e, negated; where the fit's c_e leaves no window, that at the last force where it does
    slopes = law.stretch * np.asarray(curve.local_slope(np.minimum(phi, _END)))
    levels = [with_new_level(fit, np.array([-slope, 1.0]), n, scatter) for slope in slopes.flat]
    static_level = (
        with_new_level(fit, np.array([1.0, 0.0]), n, static_scatter, own_scatter=first)
        if len(depth)
        else None
    )
    grid = RegionGrid.of(fit, [*levels, static_level])
    offsets = SharedOffsets(fit, grid)
    truth = grid.truths(truths, np.random.default_rng(seed))
    candidates = []
    between = {
        name: sum(float(x.deviation or 0.0) ** 2 for x in fit.effects if x.quantity == name)
        for name in ("c_e", "alpha")
    }
    for (R, F), slope, level in zip(
        product(radius.tolist(), force.tolist()), slopes.flat, levels, strict=True
    ):
        log_velocity, offset2 = offsets.outcome(R, partial(_log_velocity, fit, grid, F, R))
        between2 = between["alpha"] + float(slope) ** 2 * between["c_e"] + offset2
        candidates.append(_candidate(
            grid, truth, log_velocity, NewData(n, scatter, between2=between2, level=level), R, force=F,
            ceiling=_ceiling(fit, F, R, offsets.known(R)), parting=_parting(fit, against, R, F, n),
        ))  # fmt: skip
        report_progress(len(candidates), total)
    for h in depth.tolist():
        if h == depth[0] or offsets.deviations:  # without offsets, depth does not matter
            log_force, offset2 = offsets.outcome(
                static_radius, partial(_log_force, fit, grid, h, static_radius)
            )
            pairs = NewData(
                n, static_scatter, own=first, between2=between["c_e"] + offset2, level=static_level
            )  # fmt: skip
            static_pairs = _candidate(grid, truth, log_force, pairs, static_radius)
        candidates.append(replace(static_pairs, depth=h))
        report_progress(len(candidates), total)
    return Design(
        rows=tuple(
            sorted(candidates, key=lambda candidate: (-(candidate.parting or 0.0), candidate.area_ratio))
        ),
        scatter=scatter,
        static_scatter=static_scatter if len(depth) else None,
        truths=truths,
        c_e_end=fit.bounds["c_e"][1],
        open_above=fit.region("95").open_above,
        seed=seed,
        provenance=provenance(
            forces_N=force.tolist(),
            radii_mm=radius.tolist(),
            n=n,
            static_mm=depth.tolist(),
            static_radius_mm=static_radius if len(depth) else None,
            scatter=scatter,
            static_scatter=static_scatter if len(depth) else None,
            truths=truths,
            seed=seed,
            fit=repr(fit),
        ),
    )


def _parting(fit: Fit, against: Fit | None, radius: float, force: float, n: int) -> float | None:
    """How far n runs at a force raise -2 log L of another law over that of the fit, which holds."""
    velocity = float(fit.law.velocity(force, fit.c_e, fit.alpha, radius))
    if against is None or np.isnan(velocity):
        return None
    return rise_of(fit.observations, (fit.law, against.law), (force, velocity, radius), n)


def _log_velocity(
    fit: Fit, grid: RegionGrid, force: float, radius: float, offsets: Mapping[str, float]
) -> Floats:
    """ln v over the default window at each point of the grid, with offsets of what is measured, after the last run."""
    F, w = force + offsets.get("force", 0.0), offsets.get("surface", 0.0)
    R = radius + offsets.get("radius", 0.0)
    if not (F > 0.0 and 0.0 <= WINDOW_START * radius + w < WINDOW_STOP * radius + w <= R):
        return np.full(grid.log_alpha.shape, np.nan)
    window = ((part * radius + w) / R for part in (WINDOW_START, WINDOW_STOP)) if offsets else ()
    unit = np.log(fit.law.velocity(F, np.exp(grid.log_c_e), 1.0, R, *window))
    return np.asarray(unit[:, None] + grid.log_alpha + offsets.get("order", 0.0) / 2)


def _ceiling(fit: Fit, force: float, radius: float, offsets: Mapping[str, float]) -> float:
    """c_e [N/mm^2] up to which static contact passes the end of the default window."""
    F, R = force + offsets.get("force", 0.0), radius + offsets.get("radius", 0.0)
    end = (WINDOW_STOP * radius + offsets.get("surface", 0.0)) / R
    return float(F / (R**2 * end**fit.law.force_exponent))


def _log_force(
    fit: Fit, grid: RegionGrid, depth: float, radius: float, offsets: Mapping[str, float]
) -> Floats:
    """ln of the measured force of a pair over its force at c_e = 1 N/mm^2 without offsets, at each c_e of the grid."""
    R, h, q = radius + offsets.get("radius", 0.0), depth + offsets.get("surface", 0.0), fit.law.force_exponent
    unit = radius**2 * (depth / radius) ** q
    if not (h > 0.0 and R > 0.0):
        return np.full((len(grid.log_c_e), 1), np.nan)
    less = offsets.get("force", 0.0) / (
        unit * np.exp(grid.log_c_e)
    )  # of the force: as a measured one has to be above 0
    change = np.log(R ** (2 - q) * h**q / unit) - less if offsets else 0.0
    return np.asarray(grid.log_c_e + change)[:, None]


def _candidate(
    grid: RegionGrid,
    truth: tuple[Rows, Rows],
    log_outcome: Floats,
    new: NewData,
    radius: float,
    *,
    force: float | None = None,
    ceiling: float = 0.0,
    parting: float | None = None,
) -> Candidate:
    """A measurement, and what is expected of it over the truths; without a force of static pairs.

    A run is overloaded at c_e [N/mm^2] up to `ceiling`; 0 for static pairs.
    """
    row, column = truth
    overloaded = np.exp(grid.log_c_e[row]) <= ceiling
    # with its offset a shallow pair may lie above the surface: it tells nothing
    silent = ~overloaded & np.isnan(np.broadcast_to(log_outcome, grid.minus2.shape)[row, column])
    measured = ~(overloaded | silent)
    log_area, ratio = np.empty(len(row)), np.empty(len(row))
    for at, bound in ((overloaded, ceiling), (silent, np.inf)):
        if at.any():
            log_area[at], ratio[at] = grid.below(bound)
    if measured.any():
        truth = row[measured], column[measured]
        log_area[measured], ratio[measured] = grid.after(log_outcome, new, truth)
    return Candidate(
        kind="static" if force is None else "velocity",
        force=force,
        depth=None,
        radius=radius,
        n=new.n,
        area_ratio=float(np.exp(np.mean(log_area) - grid.log_area)),
        probability=float(np.mean(ratio < SEPARATE)),
        c_e_ratio=float(np.quantile(ratio, 0.5, method="lower")),
        overloaded=float(overloaded.mean()),
        parting=parting,
    )


def _positive(name: str, values: ArrayLike, unit: str) -> Floats:
    array = np.atleast_1d(np.asarray(values, dtype=np.float64))
    refuse(
        array.ndim != 1 or not (np.isfinite(array) & (array > 0)).all(),
        f"{name} must be finite and above 0{unit}: got {values!r}",
    )
    return array


def _depths(fit: Fit, static: ArrayLike | None, radius: float | None) -> tuple[Floats, float]:
    if static is None:
        return np.empty(0), np.nan
    radius = fit.radius if radius is None else radius
    if radius is None:
        raise ValueError("static_radius must be given: the data of the fit are of several radii")
    R = float(_positive("static_radius", radius, " mm")[0])
    depth = np.atleast_1d(np.asarray(static, dtype=np.float64))
    refuse(
        depth.ndim != 1 or not ((depth > 0) & (depth < 2 * R)).all(),
        f"static must be depths above 0 and below 2R = {2 * R:g} mm: got {static!r}",
    )
    return depth, R


def _scatter(fit: Fit, scatter: float | None) -> float:
    if scatter is not None:
        scatter = float(_positive("scatter", scalar(scatter, "scatter"), "")[0])
        refuse(scatter > 1, f"scatter must be the standard deviation of ln v, 0.08 for 8 %: got {scatter:g}")
        return scatter
    refuse(
        fit.residual_kind != "relative",
        f"scatter must be given, the standard deviation of ln v: the fit has {fit.residual_kind!r} residuals",
    )
    (value,) = (s.value for s in fit._evidence().scatters if s.name == "velocity")
    return float(np.hypot(value, MODEL_ERROR))


def _static_scatter(fit: Fit, scatter: float | None) -> float:
    if scatter is not None:
        return float(_positive("static_scatter", scalar(scatter, "static_scatter"), "")[0])
    values = [s.value for s in fit._evidence().scatters if s.name == "force" and not s.known]
    return float(np.hypot(values[0], MODEL_ERROR)) if values else _STATIC_SCATTER
