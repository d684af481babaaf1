"""Synthetic velocity-force curves, labelled as such."""

from __future__ import annotations

import secrets

import numpy as np
from numpy.typing import ArrayLike

from burrlab._core import Burr, Material
from burrlab.curve import VelocityCurve
from burrlab.master_curve import MasterCurve
from burrlab.provenance import provenance


def synthetic_curve(
    burr: Burr,
    material: Material,
    forces: ArrayLike,
    *,
    repeats: int = 3,
    scatter: float = 0.08,
    seed: int | None = None,
) -> VelocityCurve:
    """A velocity-force curve from the mean-field engine with log-normal scatter.

        v = v_mean_field(F) exp(scatter z),  z standard normal

    Parameters
    ----------
    burr : Burr
        The burr.
    material : Material
        What it sinks into.
    forces : array_like
        Constant forces [N]. A force that leaves no window gives a row without velocity, status "overloaded".
    repeats : int
        Rows a force.
    scatter : float
        Standard deviation of ln v; 0.08 is 8 %.
    seed : int or None
        None draws one, which the curve records. Row k of force i depends on (seed, i, k) alone.

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
    force = np.atleast_1d(np.asarray(forces, dtype=np.float64))
    if force.ndim != 1 or not (np.isfinite(force).all() and (force > 0).all()):
        raise ValueError(f"forces must be finite and above 0 N: got {forces!r}")
    if repeats < 1:
        raise ValueError(f"repeats must be at least 1: got {repeats!r}")
    if not (np.isfinite(scatter) and scatter >= 0):
        raise ValueError(f"scatter must be finite and not negative: got {scatter!r}")
    seed = secrets.randbits(32) if seed is None else int(seed)

    phi = force / (material.c_e * burr.radius**2)
    mean = 1e3 * material.alpha * burr.radius * MasterCurve(material.shape).velocity_ratio(phi)
    rows = [(i, k) for i in range(len(force)) for k in range(repeats)]
    z = np.array([np.random.default_rng([seed, i, k]).standard_normal() for i, k in rows])
    velocity = np.repeat(mean, repeats) * np.exp(scatter * z)
    status = ["ok" if np.isfinite(v) else "overloaded" for v in velocity]
    return VelocityCurve(
        np.repeat(force, repeats),
        velocity,
        status=None if np.isfinite(velocity).all() else status,
        source=f"synthetic, seed {seed}: {material.name}, mean-field, scatter {100 * scatter:g} %",
        radius=burr.radius,
        provenance=provenance(
            synthetic=True,
            c_e=material.c_e,
            alpha=material.alpha,
            shape=material.shape.name,
            radius_mm=burr.radius,
            repeats=repeats,
            scatter=scatter,
            seed=seed,
        ),
    )
