"""The result of a comparison of laws: what the data tell of the exponents, and which laws they contradict."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from burrlab.common.check import refuse
from burrlab.common.figures import (
    FORCE,
    REFERENCE,
    SERIES,
    Axes,
    Panels,
    axes_or_new,
    drawing,
    panels,
    plot_points,
    styled,
)
from burrlab.common.records import Codec
from burrlab.common.table import Tabulated, html_rows, probability_text
from burrlab.fitting.diagnostics import POOR, HypothesisTest, coarse_rounding
from burrlab.fitting.linear import components_of
from burrlab.fitting.observations import Floats, Observations
from burrlab.fitting.profile import ConfidenceInterval, plain_ends
from burrlab.fitting.report import columns, html_list, in_blocks
from burrlab.fitting.result import Fit
from burrlab.fitting.verdict import at_windows, span
from burrlab.theory.continuum import Law

HARDER = 1.1  # by how much the scale of an indentation's forces may be off, as an example
CLOSE = 4.0  #: difference of AIC below which laws are not told apart
_LEAST = {"s": 0.0, "q": 1.0, "m": 0.0}  # of a law
_MANY = 3.0  # velocities that are off by a larger factor are left out of the figure
_MEANS = {
    "s": "Velocities determine s = 2 (k + 1)/q + m, with v ~ F^s at small forces",
    "q": "The stopped burr determines q of F ~ h^q",
    "m": "With f = {law.shape}, m of the rate ~ F^m is",
    "k": "With m = {law.rate_exponent:.3g}, k of f = (1 - x^2)^k is",
}


@dataclass(frozen=True, eq=False)
class Exponent:
    """An exponent of the law, and how well the data tell it.

    Attributes
    ----------
    name : str
        ``"s"`` of v ~ F^s, ``"q"`` of F ~ h^q, ``"m"`` of the rate ~ F^m, ``"k"`` of f = (1 - x^2)^k.
    value : float
        The best; of s the mean over laws, weighted by their likelihood.
    intervals : mapping
        Level ``68``, ``95``, ``99.7`` -> ConfidenceInterval; None is open.
    grid, rise : ndarray, shape (m,)
        Values, and the rise of -2 log L there.
    limits : mapping
        Level -> rise that bounds the interval.
    if_harder : float or None
        The value if the indentation's forces were 10 % higher, of m and k.
    """

    name: str
    value: float
    intervals: Mapping[str, ConfidenceInterval]
    grid: Floats
    rise: Floats
    limits: Mapping[str, float]
    if_harder: float | None = None

    @property
    def interval_text(self) -> str:
        """That of 95 % in words."""
        interval = self.intervals["95"]
        return "no interval" if interval == ConfidenceInterval(None, None) else span(interval)


@dataclass(frozen=True)
class Parting:
    """The force at which a law parts most from the best, and about how many more runs there would tell them apart."""

    name: str
    force: float  #: [N]
    radius: float  #: [mm]
    ratio: float  #: its velocity over that of the best law
    runs: int


@dataclass(frozen=True)
class WithOffset:
    """A law with an offset of the force that the data estimate, such as a tare or a friction; by velocities alone."""

    force: float  #: true less measured [N]
    gain: float  #: by which AIC is lower than without it
    delta_aic: float  #: AIC over that of the best law without an offset


@dataclass(frozen=True, eq=False)
class LawRow:
    """One law, and how it stands among the others.

    Attributes
    ----------
    name : str
    law : Law or None
        None of v = K F.
    c_e, alpha : float
        The best point, [N/mm^2] and [1/ms]; for v = K F NaN and K [mm/(s N)]. For drawing: `fit` has the intervals.
    delta_aic, delta_error : float
        AIC over that of the best law, and its standard error.
    tests : tuple of HypothesisTest
        Against laws with one exponent more.
    p_value : float
        The smallest of the tests, by Holm.
    why : str
        A sentence on why the data contradict the law; empty where they do not.
    fit : Fit or None
        None of a law that the data contradict, and of v = K F.
    with_offset : WithOffset or None
        None of v = K F, and where offsets are known.
    """

    name: str
    law: Law | None
    c_e: float
    alpha: float
    delta_aic: float
    delta_error: float
    tests: tuple[HypothesisTest, ...]
    p_value: float
    why: str
    fit: Fit | None = field(repr=False)
    with_offset: WithOffset | None = None

    @property
    def contradicted(self) -> bool:
        """Whether the data contradict the law."""
        return bool(self.why)

    def velocity(self, force: Floats, radius: float) -> Floats:
        """Velocity at the best point [mm/s], in the default window."""
        if self.law is None:
            return self.alpha * force
        return np.asarray(self.law.velocity(force, self.c_e, self.alpha, radius))

    @property
    def constants(self) -> str:
        """c_e and alpha in words; empty where the data contradict the law."""
        if self.contradicted:
            return ""
        if self.law is None:
            return f"K = {self.alpha:.4g} mm/(s N)"
        identified = None if self.fit is None else self.fit.identified
        if self.fit is None or identified is None:
            return ""
        fit, ends = self.fit, self.fit.intervals["c_e"]["95"]
        if fit.separately_identified:
            return f"c_e = {fit.c_e:.4g} N/mm^2, alpha = {fit.alpha:.4g} /ms"
        combination = f"alpha/c_e^{identified.exponent:.4g} = {identified.value:.3g}"
        bounded = ends.lower is None or at_windows(ends, fit._window_bound)
        if ends.closed and not bounded:
            return f"c_e {span(ends)} N/mm^2; {combination}"
        low = fit.c_e if ends.lower is None else ends.lower
        return f"c_e above {low:.3g}{', set by the largest force' * bounded}; {combination}"


@dataclass(frozen=True, eq=False, repr=False)
class LawComparison(Tabulated):
    """Which laws the data follow. Made by `burrlab.compare_laws`.

    Attributes
    ----------
    rows : tuple of LawRow
        Laws that the data do not contradict, by AIC; then the others.
    exponents : mapping
        ``"s"``; with an indentation of three depths ``"q"``, ``"m"`` and ``"k"``.
    lack : HypothesisTest or None
        Whether all laws of these exponents lie off the velocities, by repeats or given sigma. The exponents but q have
        no interval where p < 0.005.
    law : Law
        The best with constants: m holds for its f, k for its m.
    level : float
        Of the tests.
    residual_kind : str
    observations : Observations
    partings : tuple of Parting
        Of the laws that are not told apart from the best.
    provenance : dict
    """

    rows: tuple[LawRow, ...]
    exponents: Mapping[str, Exponent]
    lack: HypothesisTest | None
    law: Law
    level: float
    residual_kind: str
    observations: Observations
    partings: tuple[Parting, ...]
    provenance: Mapping[str, Any]

    @property
    def best(self) -> LawRow:
        """The law of the lowest AIC among those that the data do not contradict; of all, if they contradict each."""
        return self.rows[0]

    def __getitem__(self, name: str) -> LawRow:
        names = [row.name for row in self.rows]
        refuse(name not in names, f"this comparison holds {', '.join(names)}: got {name!r}", KeyError)
        return self.rows[names.index(name)]

    @property
    def contradicted(self) -> tuple[str, ...]:
        """Laws that the data contradict."""
        return tuple(row.name for row in self.rows if row.contradicted)

    @property
    def close(self) -> tuple[LawRow, ...]:
        """The best law and those that are not told apart from it: their AIC lies within 4."""
        return tuple(row for row in self.rows if not row.contradicted and row.delta_aic < CLOSE)

    @property
    def left(self) -> tuple[LawRow, ...]:
        """Laws that the data do not contradict, but whose AIC lies 4 or more above the best."""
        return tuple(row for row in self.rows if not row.contradicted and row.delta_aic >= CLOSE)

    @property
    def sentences(self) -> tuple[str, ...]:
        """What the data tell, in plain words."""
        several = len(np.unique(self.observations.radius)) > 1
        lines = coarse_rounding(self.observations) + self._of_exponents(several)
        lines += [f"The data contradict {row.name}. {row.why}" for row in self.rows if row.contradicted]
        close = self.close
        if len(close) > 1:
            names = f"{', '.join(row.name for row in close[:-1])} and {close[-1].name}"
            lines.append(f"{names} are not told apart: their AIC lies within {CLOSE:g}.")
        elif close:
            left = ", ".join(row.name for row in self.left)
            either = f"is preferred by AIC; not contradicted either: {left}." if left else "alone is left."
            lines.append(f"{close[0].name} {either}")
        else:
            lines.append(
                "The data contradict every law here: the exponents hold if another of this form is true, and not where a "
                "tare, a friction or the surface is off, or the indentation's forces have another scale."
            )
        lines += self._with_offsets()
        lines += [
            f"{x.name} parts most from {self.best.name} at {x.force:.3g} N{f' and R = {x.radius:g} mm' if several else ''} "
            f"(velocity {x.ratio:.2f} times): about {x.runs} more {'run' if x.runs == 1 else 'runs'} there would tell them "
            "apart."
            for x in self.partings
        ]
        return tuple(line[0].upper() + line[1:] for line in lines)

    def _of_exponents(self, several: bool) -> list[str]:
        """Sentences on the exponents, and on what of the data tells them: groups, several radii and presses."""
        harder = f"; were the indentation's forces {100 * (HARDER - 1):.0f} % higher, "
        lines = [
            f"{_MEANS[name].format(law=self.law)}: {exponent.value:.3g} ({exponent.interval_text})"
            f"{'' if exponent.if_harder is None else f'{harder}{exponent.if_harder:.3g}'}."
            for name, exponent in self.exponents.items()
        ]
        lines += [
            f"No law here has {name} below {least:g}: are the columns right?"
            for name, least in _LEAST.items()
            if name in self.exponents and (self.exponents[name].intervals["95"].upper or least) < least
        ]
        lines = [self.lack.sentence, *lines] if self.lack and self.lack.p_value < POOR else lines
        if shared := dict.fromkeys(x.group for x in components_of(self.observations)):
            allowed = " and ".join(f"the {len(x.levels)} {x.name}s" for x in shared)
            lines.append(
                f"Differences between {allowed} are allowed for, with the size that the best law's fit has."
            )
        if several:
            lines.append(
                "With several radii the shape of f counts: one that is not (1 - x^2)^k, linear or the best law's moves s by "
                "about 1 %."
            )
        if "q" not in self.exponents:
            lines.append("Pressing the stopped burr, four times or more at three depths, would tell q.")
        return lines

    def _with_offsets(self) -> list[str]:
        """A sentence on the laws that fit as well as the best, or better, with an offset of the force, if any."""
        moved = [(x.delta_aic, f"{row.name} by {x.force:.2g} N (AIC {x.delta_aic:+.2g})")
                 for row in self.rows if (x := row.with_offset) and x.gain > CLOSE]  # fmt: skip
        texts = [text for delta, text in sorted(moved) if delta < CLOSE and delta < min(moved)[0] + CLOSE]
        alone = " the velocities" * bool(len(self.observations.pressed))
        return [
            f"With a force that is off, by a tare or a friction, these fit{alone} as well as {self.best.name} or better: "
            f"{', '.join(texts)}. Exponents are for a force that is right."
        ] if texts else []  # fmt: skip

    def _table(self) -> dict[str, list[Any]]:
        rows = self.rows
        return {
            "law": [row.name for row in rows],
            "what": [str(row.law) if row.law else "v = K F" for row in rows],
            "slope": [row.law.slope if row.law else 1.0 for row in rows],
            "delta_aic": [row.delta_aic for row in rows],
            "delta_error": [row.delta_error for row in rows],
            "p_value": [row.p_value for row in rows],
            "contradicted": [row.contradicted for row in rows],
            "force_offset_N": [x.force if (x := row.with_offset) else np.nan for row in rows],
            "delta_aic_with_offset": [x.delta_aic if (x := row.with_offset) else np.nan for row in rows],
            "constants": [row.constants for row in rows],
        }

    def _cells(self) -> list[list[str]]:
        table = [["law", "f and exponents", "s", "delta AIC", "tests", "constants"]]
        for row in self.rows:
            verdict = f"{probability_text(row.p_value)}{', contradicted' if row.contradicted else ''}"
            what, slope = (str(row.law), row.law.slope) if row.law else ("v = K F", 1.0)
            delta = f"{row.delta_aic:.3g} ± {row.delta_error:.2g}" if row.delta_aic else "0"
            table.append([row.name, what, f"{slope:.3g}", delta, verdict, row.constants])
        return table

    def report(self) -> str:
        """Table and sentences as text."""
        return in_blocks(
            {"Laws": columns(self._cells()), "Notes": [f"- {sentence}" for sentence in self.sentences]}
        )

    @drawing
    def plot(self, ax: Panels = None, **style: Any) -> list[Axes]:
        """Velocities and laws over force, and what the data tell of s; laws that are contradicted are grey.

        The lines are for the default window, one a radius.

        `style` is that of the points.
        """
        left, right = panels(ax, (1, 2), (9.6, 4.2))
        o = self.observations
        plot_points(left, o.force, o.velocity, None, {"ms": 3.5, "zorder": 4} | style, "data")
        colors = {row.name: look["color"] for look, row in zip(SERIES[1:], self.close, strict=False)}
        for row in self.rows:
            dress: dict[str, Any] = (
                {"color": "0.7", "linestyle": "--", "linewidth": 1.0, "label": f"_{row.name}", "zorder": 1}
                if row.contradicted
                else {"color": colors.get(row.name, REFERENCE), "linewidth": 1.4, "label": row.name}
            )
            for R in sorted(set(o.radius.tolist())):
                used = o.force[o.radius == R]
                force = np.geomspace(0.8 * used.min(), 1.25 * used.max(), 200)
                with np.errstate(invalid="ignore"):
                    left.plot(force, row.velocity(force, R), **dress)
                dress = dress | {"label": f"_{row.name}"}
        if self.contradicted:
            left.plot(
                [], [], color="0.7", linestyle="--", label=f"contradicted: {', '.join(self.contradicted)}"
            )
        low, high = o.velocity.min() / _MANY, o.velocity.max() * _MANY
        left.set(xscale="log", yscale="log", xlabel="force [N]", ylabel="velocity [mm/s]", ylim=(low, high))
        self.plot_exponent(ax=right)
        return [left, right]

    @drawing
    def plot_exponent(self, name: str = "s", ax: Axes | None = None, **style: Any) -> Axes:
        """The rise of -2 log L over an exponent, with the limits of three levels and the laws' own values."""
        refuse(name not in self.exponents, f"the data tell {', '.join(self.exponents)}: got {name!r}")
        exponent, ax = self.exponents[name], axes_or_new(ax)
        largest = max(exponent.limits.values())
        ax.plot(exponent.grid, exponent.rise, **styled(style, color=FORCE, linewidth=1.4))
        for level, limit in exponent.limits.items():
            ax.axhline(limit, color=REFERENCE, linewidth=0.8, linestyle="--")
            ax.annotate(f"{level} %", (0.995, limit), xycoords=("axes fraction", "data"), xytext=(0, 2),
                        textcoords="offset points", ha="right", fontsize=8, color=REFERENCE)  # fmt: skip
        ax.set(xlabel=_AXES[name], ylabel="rise of $-2 \\log L$", ylim=(0, 1.25 * largest))
        ax.set_xlim(exponent.grid[0], exponent.grid[-1])
        ax.set_title(
            f"{'mean ' * (name == 's')}{name} = {exponent.value:.3g}, 95 %: {exponent.interval_text}"
        )
        return ax

    def to_dict(self) -> dict[str, Any]:
        """All but the data as plain Python objects, ready for JSON; infinities and NaN are None."""
        exponents = {
            name: {"value": x.value, "intervals": plain_ends({name: x.intervals})[name]}
            for name, x in self.exponents.items()
        }
        return dict(Codec().plain({
            "rows": [dict(zip(self._table(), cells, strict=True)) | {"tests": row.tests}
                     for row, cells in zip(self.rows, zip(*self._table().values(), strict=True), strict=True)],
            "exponents": exponents, "shape": str(self.law.shape), "rate_exponent": self.law.rate_exponent, "level": self.level, "residuals": self.residual_kind,
            "partings": self.partings, "sentences": self.sentences, "provenance": self.provenance,
        }))  # fmt: skip

    def __repr__(self) -> str:
        return "\n".join(columns(self._cells()))

    def _repr_html_(self) -> str:
        return html_rows(self._cells()) + html_list(self.sentences)


_AXES = {
    "s": "$s$ of $v \\sim F^s$ at small forces",
    "q": "$q$ of $F \\sim h^q$",
    "m": "$m$ of the rate $\\sim F^m$",
    "k": "$k$ of $f = (1 - x^2)^k$",
}
