"""Brown's polynomial and rational lens as OpenCV orders it: k1 k2 p1 p2 k3 k4 k5 k6; shorter: k1, or k1 k2."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def distort(points: Array, distortion: tuple[float, ...]) -> Array:
    """(N,3) points, z > 0 -> (N,2)."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (*distortion, *[0.0] * (8 - len(distortion)))
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=1,
    )


def first_guess(distorted: Array) -> Array:
    """As if there were no distortion."""
    return distorted


@lru_cache(maxsize=64)
def valid_angle(distortion: tuple[float, ...]) -> float:
    """Angle off the axis, rad, at which the distorted radius stops growing; 1.5 if it grows throughout."""
    theta = np.linspace(0, 1.5, 3000)
    ahead = np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=1)
    falling = np.flatnonzero(np.diff(distort(ahead, distortion)[:, 0]) <= 0)
    return float(theta[falling[0]] if len(falling) else theta[-1])
