"""The record of a fit: parameters, evidence, residuals, data and provenance; and its JSON."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from burrlab._core import Burr, Shape
from burrlab.common.check import check_same_length, refuse
from burrlab.common.records import Codec, InJson
from burrlab.common.table import by_value
from burrlab.fitting.calibration import AnyCalibration, Calibration, RowScatter
from burrlab.fitting.diagnostics import Goodness, HypothesisTest, Plausibility, Row
from burrlab.fitting.group_effects import MixedEffect, MixedEvidence
from burrlab.fitting.likelihood import Likelihood
from burrlab.fitting.observations import Bounds, Data, Floats, Observations, ResidualKind
from burrlab.fitting.profile import (
    LEVELS,
    ByLevel,
    ByName,
    Combination,
    ConfidenceInterval,
    Profile,
    plain_ends,
)
from burrlab.fitting.repairs import Repair, Sensitivity, repairs, sensitivities
from burrlab.fitting.verdict import Ridge, Start, obstacle
from burrlab.fitting.voxel import VoxelTable, model_of
from burrlab.measured.curve import Indentation, VelocityCurve
from burrlab.measured.depth_trace import DepthTrace
from burrlab.theory.continuum import PAPER_FORCE_EXPONENT, Law

_OPEN = ConfidenceInterval(None, None)


@dataclass(frozen=True, eq=False, repr=False)
class FitRecord(InJson):
    """The data of a fit, what follows from them, and their JSON; `Fit` describes them, and adds tests and figures."""

    c_e: float
    alpha: float
    shape: Shape
    radius: float | None
    residual_kind: ResidualKind
    residual_norm: float
    residuals: Floats
    predicted: Floats
    chi2_reduced: float | None
    n_points: int
    n_skipped: int
    n_censored: int
    status: str
    reason: str
    starts: tuple[Start, ...]
    bounds: Bounds
    given_bounds: tuple[str, ...]
    evidence: "Evidence | None"
    lack_of_fit: HypothesisTest | None
    fall: HypothesisTest | None
    engine: str
    table: VoxelTable | None
    seed: int
    evaluations: int
    seconds: float
    record: tuple[tuple[float, float], ...]
    data: tuple[Data, ...]
    provenance: Mapping[str, Any]
    force_exponent: float = PAPER_FORCE_EXPONENT
    rate_exponent: float = 0.0

    def __post_init__(self) -> None:
        Law(self.shape, self.force_exponent, self.rate_exponent)  # which checks the exponents of a file

    @property
    def law(self) -> Law:
        """Erosion shape and exponents."""
        return Law(self.shape, self.force_exponent, self.rate_exponent)

    @property
    def curve(self) -> VelocityCurve:
        """The first velocity curve of the data; ValueError without one."""
        curves = [data_set for data_set in self.data if isinstance(data_set, VelocityCurve)]
        refuse(not curves, "the data of this fit hold no velocity curve")
        return curves[0]

    def _evidence(self) -> "Evidence":
        """The evidence; ValueError if the fit gave nothing."""
        if self.evidence is None:
            raise ValueError(f"this fit gave nothing to judge by: {self.reason}")
        return self.evidence

    @property
    def intervals(self) -> Mapping[str, Mapping[str, ConfidenceInterval]]:
        """``c_e``, ``alpha`` -> ``68``, ``95``, ``99.7`` -> ConfidenceInterval, by profile likelihood; None is open."""
        if self.evidence is None:
            return ByName({name: ByLevel(dict.fromkeys(LEVELS, _OPEN)) for name in ("c_e", "alpha")})
        return self.evidence.profile.intervals

    @property
    def identified(self) -> Combination | None:
        """alpha/c_e^p, the combination that the data determine best."""
        return None if self.evidence is None else self.evidence.profile.identified

    @property
    def separately_identified(self) -> bool:
        """Whether c_e's 95 % interval has two ends within a factor of 2, and nothing speaks against it.

        False where alpha's is open, where the data contradict the model or are implausible, where the fit ended
        at a bound, and where c_e's begins at the bound F/(0.1925 R^2) that a window sets.
        """
        return not self._obstacle

    @property
    def _obstacle(self) -> str:
        """Why c_e and alpha are not separately identified; empty where they are."""
        if self.evidence is None:
            return "nothing was fitted"
        status, _ = self.evidence.doubt or (self.status, "")
        c_e, alpha = (self.intervals[name]["95"] for name in ("c_e", "alpha"))
        return obstacle(c_e, alpha, self._window_bound, status)

    @property
    def _window_bound(self) -> float:
        """The bound of c_e that windows set [N/mm^2], as far as offsets and specimens of their own leave it."""
        return self.likelihood.observations.c_e_floor

    @property
    def verdict(self) -> str:
        """What the data determine, in plain words, at 95 %."""
        return self.reason if self.evidence is None else self.evidence.verdict

    @property
    def ridge(self) -> Ridge | None:
        """The position of the data relative to the ridge."""
        return None if self.evidence is None else self.evidence.ridge

    @property
    def _on_ridge(self) -> Combination | None:
        """What the data determine where they leave c_e open above; None where they do not."""
        return None if self.evidence is None or self.evidence.ridge.excluded else self.identified

    @property
    def effects(self) -> tuple[MixedEffect, ...]:
        """What differs between days and specimens, and offsets; empty for a fit without."""
        return self.evidence.mixed.effects if self.evidence and self.evidence.mixed else ()

    @property
    def correlation(self) -> float:
        """Correlation of log c_e and log alpha, from the Fisher information at the fit."""
        if self.evidence is None:
            return np.nan
        information = self.evidence.information
        return float(-information[0, 1] / np.sqrt(information[0, 0] * information[1, 1]))

    @property
    def condition(self) -> float:
        """Condition number of the Fisher information in (log c_e, log alpha): large along a ridge."""
        return np.nan if self.evidence is None else float(np.linalg.cond(self.evidence.information))

    @property
    def n_parameters(self) -> int:
        """c_e, alpha and the scatters that were estimated."""
        of_effects = (len(x.levels) if x.deviation is None else x.interval is not None for x in self.effects)
        scatters = self.evidence.scatters if self.evidence else ()
        return 2 + sum(not s.known for s in scatters) + sum(of_effects)

    @property
    def log_likelihood(self) -> float:
        """log L at the fit, with all constants."""
        return np.nan if self.evidence is None else self.evidence.log_likelihood

    @property
    def aic(self) -> float:
        """2 k - 2 log L, k the number of parameters."""
        return 2 * self.n_parameters - 2 * self.log_likelihood

    @property
    def bic(self) -> float:
        """k log n - 2 log L."""
        return self.n_parameters * float(np.log(self.n_points)) - 2 * self.log_likelihood

    @property
    def best(self) -> Start:
        """The search that found the parameters."""
        return min(self.starts, key=lambda start: (start.end != (self.c_e, self.alpha), start.objective))

    @cached_property
    def observations(self) -> Observations:
        """The rows of the data, as they were compared."""
        burr = Burr(self.radius) if self.radius and any(x.radius is None for x in self.data) else None
        return Observations.of(self.data, burr, tuple(self.provenance.get("groups", ())), self.law)

    @cached_property
    def likelihood(self) -> Likelihood:
        """-2 log L of the data, with the model that was fitted."""
        mixed = self.evidence.mixed if self.evidence is not None else None
        return mixed.likelihood(self._plain, (self.c_e, self.alpha)) if mixed else self._plain

    @property
    def _plain(self) -> Likelihood:
        """The likelihood without groups and offsets."""
        known = self.provenance.get("known", {})
        beliefs = tuple((name, *numbers) for name, numbers in known.items())
        kind = (
            "log-sigma" if self.residual_kind == "sigma" and (self.effects or known) else self.residual_kind
        )
        return Likelihood(
            self.observations, kind, model_of(self.observations, self.shape, self.table), beliefs
        )

    @cached_property
    def sensitivity(self) -> tuple[Sensitivity, ...]:
        """How far alpha/c_e^p is off if surface, force or radius are; empty if the fit gave nothing.

        Calculated when first asked for, which takes some 40 ms for each window that the process has not met.
        """
        identified = self.identified
        return sensitivities(self.likelihood, (self.c_e, self.alpha), identified) if identified else ()

    @cached_property
    def repairs(self) -> tuple[Repair, ...]:
        """Other explanations of the data, by falling gain of AIC: an offset, another radius, another shape.

        Empty if the fit gave nothing, or for the voxel engine. Calculated when first asked for.
        """
        if self.evidence is None or self.table is not None or self.observations.slow.size:
            return ()
        return repairs(self._plain, self.likelihood, (self.c_e, self.alpha), self.aic, self.n_parameters)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """The fit that `to_dict` described."""
        # `burrlab fit --test` adds its test
        return super().from_dict({name: value for name, value in values.items() if name != "test"})


@by_value
@dataclass(frozen=True)
class Evidence:
    """Evidence of the likelihood.

    Attributes
    ----------
    log_likelihood : float
        log L at the fit, with all constants, for velocities in mm/s and forces in N.
    information : ndarray, shape (2, 2)
        Fisher information in (log c_e, log alpha).
    scatters : tuple of RowScatter
        Estimated or given.
    shares : ndarray, shape (len(scatters), 2, 2)
        What each scatter adds to the information.
    monte_carlo : float
        SE_mc^2/SE_stat^2 of a stochastic engine; 0 for mean-field. The limits are wider by 1 + this.
    profile : Profile
    ridge : Ridge
    verdict : str
        What the data determine at 95 %, in plain words.
    better : (float, float) or None
        A better point (c_e, alpha) than the fit, where the walk met one outside the bounds of the search.
    goodness : Goodness or None
        Whether the data contradict the model; None in fits of earlier versions, as the next three.
    unscaled : mapping or None
        The intervals without the factor of `goodness`, where there is one.
    plausibility : Plausibility or None
        Whether a plausible material could have given the data.
    rows : tuple of Row
        The rows that stand out.
    mixed : MixedEvidence or None
        What differs between days and specimens, and offsets; None without.
    """

    log_likelihood: float
    information: Floats
    scatters: tuple[RowScatter, ...]
    shares: Floats
    monte_carlo: float
    profile: Profile
    ridge: Ridge
    verdict: str
    better: tuple[float, float] | None = None
    goodness: Goodness | None = None
    unscaled: Mapping[str, Mapping[str, ConfidenceInterval]] | None = None
    plausibility: Plausibility | None = None
    rows: tuple[Row, ...] = ()
    mixed: MixedEvidence | None = None

    def __post_init__(self) -> None:
        if self.mixed is None:  # else there is one share, of all
            check_same_length(share=self.shares, scatters=self.scatters)

    @property
    def doubt(self) -> tuple[str, str] | None:
        """Status and reason where the diagnostics speak against the fit."""
        if self.plausibility is not None and self.plausibility.implausible:
            return "implausible", f"These data are implausible: {self.plausibility.sentence}."
        if self.goodness is not None and self.goodness.poor:
            return "poor-fit", self.goodness.sentence
        return None

    @property
    def calibration(self) -> AnyCalibration:
        """The limits that the intervals and tests use."""
        inflation = 1.0 if self.goodness is None else self.goodness.inflation
        if self.mixed is not None:
            return replace(self.mixed.calibration, monte_carlo=self.monte_carlo, inflation=inflation)
        return Calibration(self.scatters, self.information, self.shares, self.monte_carlo, inflation)


FitRecord._codec = Codec(
    keys={
        FitRecord: {
            {"radius": "radius_mm", "residual_norm": "residual"}.get(f.name, f.name): f.name
            for f in fields(FitRecord)
        }
        | {
            "intervals": lambda fit: plain_ends(fit.intervals),
            "identified": lambda fit: (
                (combination := fit.identified)
                and {
                    "exponent": combination.exponent,
                    "value": combination.value,
                    "interval": [combination.interval.lower, combination.interval.upper],
                }
            ),
            "separately_identified": lambda fit: fit.separately_identified,
            "verdict": lambda fit: fit.verdict,
            "version": lambda fit: fit.provenance.get("burrlab"),
        }
    },
    null={(Start, "objective"): math.inf, (Ridge, "residual"): math.inf},
    kinds={"velocity": VelocityCurve, "indentation": Indentation, "trace": DepthTrace},
)
