"""Synthetic data sets; their sources say so."""

import warnings
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from burrlab._core import Burr, Material
from burrlab.common.check import real, refuse, scalar, seed_or_new, whole
from burrlab.common.provenance import provenance
from burrlab.common.table import Floats
from burrlab.measured.curve import Indentation, VelocityCurve
from burrlab.measured.depth_trace import DepthTrace
from burrlab.theory.continuum import mean_field_descent, penetration_velocity
from burrlab.theory.tool import law_of, require_tool


def synthetic_curve(
    burr: Burr,
    material: Material,
    forces: ArrayLike,
    *,
    repeats: int = 3,
    scatter: float = 0.08,
    seed: int | None = None,
) -> VelocityCurve:
    r"""A velocity-force curve from the mean-field engine with log-normal scatter.

    .. math::

       v = v_\text{mean field}(F)\, e^{\text{scatter}\, z}, \qquad z \sim N(0, 1)

    Parameters
    ----------
    burr : Burr
    material : Material
    forces : array_like
        Constant forces [N]. A force without a window gives a row without velocity, status "overloaded".
    repeats : int
        Rows a force.
    scatter : float
        Standard deviation of ln v; 0.08 is 8 %.
    seed : int or None
        None draws a seed; the curve records it. Row k of force i depends on (seed, i, k) alone.

    Returns
    -------
    VelocityCurve
        Over the default window; its source begins with "synthetic".

    Raises
    ------
    ValueError
        If a force is not positive and finite, repeats is below 1, or scatter is negative or not finite.

    Examples
    --------
    >>> import burrlab
    >>> burrlab.synthetic_curve(burrlab.Burr(3.0), burrlab.materials["bone"], [0.5, 1.0], seed=1)
    VelocityCurve(6 rows, 6 with a velocity, 0.5..1 N, 'synthetic, seed 1: bone, mean-field, scatter 8 %')
    """
    require_tool(burr, material)
    force = np.atleast_1d(real(forces, "forces"))
    refuse(
        force.ndim != 1 or not (np.isfinite(force).all() and (force > 0).all()),
        f"forces must be finite and above 0 N: got {forces!r}",
    )
    seed = seed_or_new(seed)

    velocity = _scattered(np.asarray(penetration_velocity(burr, material, force)), repeats, scatter, seed)
    finite = np.isfinite(velocity)
    return VelocityCurve(
        np.repeat(force, repeats),
        velocity,
        status=None if finite.all() else ["ok" if known else "overloaded" for known in finite],
        source=f"synthetic, seed {seed}: {material.name}, mean-field, scatter {100 * scatter:g} %",
        radius=burr.radius,
        provenance=_provenance(burr, material, seed, repeats=repeats, scatter=scatter),
    )


def synthetic_indentation(
    burr: Burr,
    material: Material,
    depths: ArrayLike,
    *,
    repeats: int = 1,
    scatter: float = 0.1,
    seed: int | None = None,
) -> Indentation:
    r"""Static indentation by Eq. 3 with log-normal scatter of the force.

    .. math::

       F = c_e R^2 (h/R)^{3/2}\, e^{\text{scatter}\, z}, \qquad z \sim N(0, 1)

    Parameters
    ----------
    burr : Burr
    material : Material
    depths : array_like
        Penetration depths h [mm], below 2R.
    repeats : int
        Rows a depth.
    scatter : float
        Standard deviation of ln F; 0.1 is 10 %.
    seed : int or None
        None draws a seed; the data set records it. Row k of depth i depends on (seed, i, k) alone.

    Returns
    -------
    Indentation
        Its source begins with "synthetic".

    Raises
    ------
    ValueError
        If a depth is not above 0 and below 2R, repeats is below 1, or scatter is negative or not finite.

    Examples
    --------
    >>> import burrlab
    >>> burrlab.synthetic_indentation(burrlab.Burr(5.0), burrlab.materials["bone"], [0.05, 0.1], seed=1)
    Indentation(2 rows, R = 5 mm, 0.0555..0.16 N at 0.05..0.1 mm, 'synthetic, seed 1: bone, Eq. 3, scatter 10 %')
    """
    require_tool(burr, material)
    depth = np.atleast_1d(real(depths, "depths"))
    refuse(
        depth.ndim != 1 or not ((depth > 0) & (depth < 2 * burr.radius)).all(),
        f"depths must be above 0 and below 2R = {2 * burr.radius:g} mm: got {depths!r}",
    )
    seed = seed_or_new(seed)

    force = material.c_e * burr.radius**2 * (depth / burr.radius) ** material.force_exponent  # Eq. 3
    law = f"F ~ h^{material.force_exponent:g}" if "force_exponent" in law_of(material) else "Eq. 3"
    return Indentation(
        _scattered(force, repeats, scatter, seed),
        np.repeat(depth, repeats),
        burr.radius,
        source=f"synthetic, seed {seed}: {material.name}, {law}, scatter {100 * scatter:g} %",
        provenance=_provenance(burr, material, seed, repeats=repeats, scatter=scatter),
    )


def synthetic_trace(
    burr: Burr,
    material: Material,
    force: float,
    *,
    run_scatter: float = 0.08,
    noise: float = 0.002,
    step: float = 0.01,
    sample_ms: float = 1.0,
    seed: int | None = None,
) -> DepthTrace:
    r"""A record of a mean-field descent with scatter of its rate, noise of position, and readings in steps.

    .. math::

       H(t) = \text{step} \cdot \text{round}\left(\frac{H_\text{mean field}(t\, e^{-\text{run scatter}\, z}) + \text{noise}\, e(t)}
       {\text{step}}\right), \qquad z, e(t) \sim N(0, 1)

    Parameters
    ----------
    burr : Burr
    material : Material
    force : float
        Constant force [N].
    run_scatter : float
        Standard deviation of the logarithm of the run's duration; 0.08 is 8 %.
    noise : float
        Standard deviation of a position before rounding [mm].
    step : float
        Step to which positions are rounded [mm]; 0: no rounding.
    sample_ms : float
        Time between samples [ms].
    seed : int or None
        None draws a seed; the record keeps it.

    Returns
    -------
    DepthTrace
        From static contact to R/3; its source begins with "synthetic".

    Raises
    ------
    ValueError
        If run_scatter, noise or step is negative or not finite, sample_ms is not positive and finite, fewer
        than ten samples lie in the window, or `mean_field_descent` refuses the force.

    Examples
    --------
    >>> import burrlab
    >>> burrlab.synthetic_trace(burrlab.Burr(3.0), burrlab.materials["bone"], 1.0, seed=1).immersion[::200]
    array([0.42, 0.64, 0.76, 0.85, 0.93, 1.  ])
    """
    for name, value in (("run_scatter", run_scatter), ("noise", noise), ("step", step)):
        _check_not_negative(name, value)
    refuse(
        not 0 < scalar(sample_ms, "sample_ms") < np.inf,
        f"sample_ms must be finite and above 0: got {sample_ms!r}",
    )
    descent = mean_field_descent(burr, material, force)
    seed = seed_or_new(seed)

    random = np.random.default_rng(seed)
    stretched = descent.time * np.exp(run_scatter * random.standard_normal())
    time = np.arange(0.0, stretched[-1], 1e-3 * sample_ms)
    immersion = np.interp(time, stretched, descent.immersion) + noise * random.standard_normal(len(time))
    return DepthTrace(
        time,
        step * np.round(immersion / step) if step > 0 else immersion,
        force,
        burr.radius,
        source=f"synthetic, seed {seed}: {material.name}, mean-field, {force:g} N",
        provenance=_provenance(
            burr, material, seed, run_scatter=run_scatter, noise_mm=noise, step_mm=step, sample_ms=sample_ms
        ),
    )


def _check_not_negative(name: str, value: float) -> None:
    refuse(not 0 <= scalar(value, name) < np.inf, f"{name} must be finite and not negative: got {value!r}")


def _scattered(values: Floats, repeats: int, scatter: float, seed: int) -> Floats:
    """Each value `repeats` times with log-normal scatter; z of row k of value i depends on (seed, i, k)."""
    refuse(whole("repeats", repeats, 2**31, "2^31") < 1, f"repeats must be at least 1: got {repeats!r}")
    _check_not_negative("scatter", scatter)
    if scatter > 1:
        warnings.warn(f"scatter = {scatter:g} is {100 * scatter:g} %; 8 % is 0.08", stacklevel=3)
    z = np.array([
        np.random.default_rng([seed, *place]).standard_normal() for place in np.ndindex(len(values), repeats)
    ])  # fmt: skip
    return np.repeat(values, repeats) * np.exp(scatter * z)


def _provenance(burr: Burr, material: Material, seed: int, **parameters: float) -> dict[str, Any]:
    return provenance(
        synthetic=True,
        c_e=material.c_e,
        alpha=material.alpha,
        shape=material.shape.name,
        **law_of(material),
        radius_mm=burr.radius,
        **parameters,
        seed=seed,
    )
