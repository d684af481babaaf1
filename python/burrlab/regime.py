"""Closed forms of the descent at constant force: static contact, stiffness, layer thickness."""

from __future__ import annotations

import math

import numpy as np

from burrlab._core import Burr, Material


def relative_force(burr: Burr, material: Material, force: float) -> float:
    """phi = F/(c_e R^2), the one number besides f that a descent depends on."""
    return force / (material.c_e * burr.radius**2)


def static_immersion(burr: Burr, material: Material, force: float) -> float:
    """Depth of the tip at which intact bone alone carries the force, R phi^(2/3) (Eqs. 2, 3) [mm].

    Examples
    --------
    >>> import burrlab
    >>> round(static_immersion(burrlab.Burr(3.0), burrlab.materials["bone"], 1.0), 4)
    0.4169
    """
    return float(burr.radius * relative_force(burr, material, force) ** (2 / 3))


def contact_stiffness(c_e: float, radius: float, force: float, immersion: float) -> float:
    """k = dF/dH at force F in a hole of depth H [N/mm].

    k = 1.5 c_e sqrt(u) (2 R H - H^2) / (R (2u - u^2)), u = (F/(c_e R^2))^(2/3). It grows as F falls in a hole.

    Parameters
    ----------
    c_e : float
        [N/mm^2]
    radius, immersion : float
        R, H [mm]; H is taken at least at the static contact.
    force : float
        F [N]
    """
    u = min((force / (c_e * radius**2)) ** (2 / 3), 1.0)
    depth = min(max(immersion, u * radius), radius)
    area = 2 * radius * depth - depth**2  # wetted, projected on the axis, over pi
    return float(1.5 * c_e * math.sqrt(u) * area / (radius * (2 * u - u * u)))


def layer_thickness(burr: Burr, material: Material, velocity: float) -> float | None:
    """Thickness of the layer in which the burr cuts, delta_0 = sqrt(2 pi R v/(kappa alpha))/2 [mm].

    kappa = -f'(1): 2 for the parabolic, 1 for the linear shape; None for an f whose zero is not simple.

    Parameters
    ----------
    velocity : float
        v [mm/s]
    """
    kappa = {"parabolic": 2.0, "linear": 1.0}.get(material.shape.name)
    if kappa is None or material.alpha == 0.0:
        return None
    return float(0.5 * np.sqrt(2 * np.pi * burr.radius * velocity / (kappa * 1e3 * material.alpha)))
