"""Kannala and Brandt's fisheye (PAMI 2006) with four terms, as OpenCV has it, or with fewer.

The distorted radius is theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8), theta the angle off the axis.
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
STEPS = 6000  # of the half circle
WIDEST_GUESS = 1.3  # rad; tan grows without bound beyond


def distort(points: Array, distortion: tuple[float, ...]) -> Array:
    """(N,3) points, any z -> (N,2)."""
    radius = np.hypot(points[:, 0], points[:, 1])
    theta = np.arctan2(radius, points[:, 2])
    t2 = theta * theta
    added = np.zeros_like(t2)
    for k in reversed(distortion):
        added = t2 * (k + added)
    distorted = theta * (1 + added)
    scale = np.divide(distorted, radius, out=np.ones_like(radius), where=radius > 1e-12)
    return points[:, :2] * scale[:, None]


def first_guess(distorted: Array) -> Array:
    """As if the distorted radius were the angle itself."""
    theta = np.linalg.norm(distorted, axis=1, keepdims=True)
    return distorted * (np.tan(np.minimum(theta, WIDEST_GUESS)) / np.maximum(theta, 1e-9))


@lru_cache(maxsize=64)
def valid_angle(distortion: tuple[float, ...]) -> float:
    """Angle off the axis, rad, at which the distorted radius stops growing; infinite if it grows all round."""
    theta = np.linspace(0, math.pi, STEPS)
    ahead = np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=1)
    falling = np.flatnonzero(np.diff(distort(ahead, distortion)[:-1, 0]) <= 0)  # straight behind has no direction
    return float(theta[falling[0]]) if len(falling) else math.inf
