"""The effective depth G(e, tau) of a layer cut at a voxel's faces, by quadrature and root finding."""

import math

from scipy.integrate import quad
from scipy.optimize import brentq

RELATIVE_ACCURACY = 1e-12  # of each integral


def layer_integral(a: float, e: float, order: float, moment: float = 0.0) -> float:
    """Integral of x^moment exp(-a x^(order + 1)) over x = e..e + 1.

    Parameters
    ----------
    a : float
        Steepness of the layer's profile, >= 0 [1].
    e : float
        Depth of the voxel's outer face, in voxels, >= 0 [1].
    order : float
        Order k of the zero of the erosion shape at the sphere's surface, > 0 [1].
    moment : float
        Power of x in the integrand [1].

    Returns
    -------
    float
        The integral [1].
    """
    end = e + 1.0
    if a > 0.0:  # beyond this end the profile is below exp(-50) of its peak; quadrature could miss the peak
        end = min(end, (e ** (order + 1.0) + 50.0 / a) ** (1.0 / (order + 1.0)))

    def integrand(x: float) -> float:
        return x**moment * math.exp(-a * x ** (order + 1.0))

    value, _ = quad(integrand, e, end, epsabs=0.0, epsrel=RELATIVE_ACCURACY, limit=200)
    return float(value)


def effective_depth(e: float, tau: float, order: float) -> float:
    r"""Depth at which a uniform layer erodes like the profile of a steady cut, in voxels.

    .. math::
        G(e, \tau) = \left[\frac{1}{\tau} \int_e^{e+1} x^k \exp(-a x^{k+1})\, dx \right]^{1/k},
        \qquad \int_e^{e+1} \exp(-a x^{k+1})\, dx = \tau .

    Parameters
    ----------
    e : float
        Depth of the voxel's outer face below the sphere's surface, in voxels, >= 0 [1].
    tau : float
        Remaining fraction of the voxel, 0..1 [1].
    order : float
        Order k of the zero of the erosion shape at the sphere's surface, > 0 [1].

    Returns
    -------
    float
        G, in e..e + 1 [1]; absolute error below 1e-8.

    Notes
    -----
    Limits: tau = 0 gives G = e, for the rest lies at the outer face; tau = 1 gives a = 0, a uniform voxel.
    """
    if tau <= 0.0:
        return e
    if tau >= 1.0:
        return layer_integral(0.0, e, order, moment=order) ** (1.0 / order)
    steep = 1.0
    while layer_integral(steep, e, order) > tau:
        steep *= 2.0
    a = brentq(lambda a: layer_integral(a, e, order) - tau, 0.0, steep, xtol=1e-14, rtol=1e-14)
    return (layer_integral(a, e, order, moment=order) / tau) ** (1.0 / order)


def depth_of_full_voxel(order: float) -> float:
    """Closed form of G(0, 1) = (k + 1)^(-1/k)."""
    return (order + 1.0) ** (-1.0 / order)


def depth_of_thin_layer(tau: float, order: float) -> float:
    """Closed form of G(0, tau) for small tau: tau [(k + 1) Gamma(1 + 1/(k + 1))^(k + 1)]^(-1/k)."""
    gamma = math.gamma(1.0 + 1.0 / (order + 1.0))
    return tau * ((order + 1.0) * gamma ** (order + 1.0)) ** (-1.0 / order)
