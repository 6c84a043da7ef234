"""Scaramuzza's omnidirectional lens (ICVS 2006, OCamCalib), as MATLAB's fisheyeIntrinsics and C3VD have it.

A pixel's ray is (u, v, a0 + a2 rho^2 + a3 rho^3 + a4 rho^4), rho^2 = u^2 + v^2, where (u, v) is the pixel from the
centre, taken back through the stretch matrix [[c, d], [e, 1]].

The focal length is a0, and the distortion is b2 = a0 a2, b3 = a0^2 a3, b4 = a0^3 a4, c, d, e: numbers without a unit,
so that a picture of half the size has the same. The way from a ray to its pixel has no closed form: Newton's method
finds it, from a table of the angles of all radii.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Distortion = tuple[float, ...]
WIDEST_RADIUS, STEPS = 3.0, 6000  # of the table, in focal lengths; a fisheye's picture ends below 2
NEWTON_STEPS = 1  # from a guess that is off by 1e-7


def parameters_of(
    a0: float, a2: float, a3: float, a4: float, centre: tuple[float, float], stretch: tuple[float, float, float]
) -> tuple[float, ...]:
    """The camera's parameters (9) from the published coefficients, in pixels; stretch: c, d, e."""
    return (a0, *centre, a0 * a2, a0**2 * a3, a0**3 * a4, *stretch)


def distort(points: Array, distortion: Distortion) -> Array:
    """(N,3) points, any z -> (N,2)."""
    angles, radii = _table(distortion)
    x, y, z = points.T
    across = np.hypot(x, y)
    length = np.maximum(np.hypot(across, z), 1e-300)
    sine, cosine = across / length, z / length
    theta = np.arctan2(across, z)
    rho = np.interp(theta, angles, radii)
    for _ in range(NEWTON_STEPS):  # rho cos(theta) = g(rho) sin(theta)
        slope = cosine - _slope(rho, distortion) * sine
        rho = rho - (rho * cosine - _forward(rho, distortion) * sine) / np.where(np.abs(slope) > 1e-9, slope, np.inf)
    # Past the widest angle there is no pixel; one farther and farther out keeps what follows continuous.
    rho = np.where(theta < angles[-1], rho, radii[-1] + theta - angles[-1])
    scale = np.divide(rho, across, out=np.ones_like(rho), where=across > 1e-12)
    c, d, e = distortion[3:]
    u, v = x * scale, y * scale
    return np.stack([c * u + d * v, e * u + v], axis=1)


def undistort(distorted: Array, distortion: Distortion) -> Array:
    """(N,2) -> (N,2) on the plane z = 1, in closed form; far off the axis where the ray looks sideways or behind."""
    c, d, e = distortion[3:]
    u, v = distorted.T
    across, down = (u - d * v) / (c - d * e), (c * v - e * u) / (c - d * e)
    ahead = np.maximum(_forward(np.hypot(across, down), distortion), 1e-3)
    return np.stack([across / ahead, down / ahead], axis=1)


def valid_angle(distortion: Distortion) -> float:
    """Angle off the axis, rad, at which a larger radius no longer looks farther out."""
    return float(_table(distortion)[0][-1])


@lru_cache(maxsize=16)
def _table(distortion: Distortion) -> tuple[Array, Array]:
    """Angles off the axis, rad, growing, and the radii that look there, in focal lengths."""
    radii = np.linspace(0, WIDEST_RADIUS, STEPS)
    angles = np.arctan2(radii, _forward(radii, distortion))
    falling = np.flatnonzero(np.diff(angles) <= 0)
    end = int(falling[0]) + 1 if len(falling) else STEPS
    return angles[:end], radii[:end]


def _forward(rho: Array, distortion: Distortion) -> Array:
    """The ray's third component over a0."""
    b2, b3, b4 = distortion[:3]
    return 1 + rho**2 * (b2 + rho * (b3 + rho * b4))


def _slope(rho: Array, distortion: Distortion) -> Array:
    b2, b3, b4 = distortion[:3]
    return rho * (2 * b2 + rho * (3 * b3 + rho * 4 * b4))
