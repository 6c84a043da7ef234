"""Interreflection: light that one wall reflects to another.

The light sits beside the lens, so what it lights is what the camera sees: the image itself is the map of light sources
(reflective shadow map, Dachsbacher & Stamminger 2005). Occlusion between walls and walls outside of the image are left
out.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating[Any]]
SOURCES, RECEIVERS = 16, 24  # patches per side of the image; interreflection is smooth
MIN_DISTANCE_MM = 4.0  # between patches; closer, a patch is no point source
MIN_COSINE = 0.15  # of the view of a patch; below, its area cannot be estimated from the image


def bounced(points: Floats, normals: Floats, radiance: Floats) -> Floats:
    """Irradiance over pi (H,W,3) that wall points (H,W,3) mm with unit normals get from all other visible wall.

    Sum over patches of radiance * cosine leaving * cosine arriving * area / (pi * distance^2).
    """
    height, width = points.shape[:2]
    at, facing, sent = (_coarse(field, SOURCES) for field in (points, normals, radiance))
    to, towards = (_coarse(field, RECEIVERS) for field in (points, normals))
    area = _patch_areas(at, facing)
    squared = (to * to).sum(axis=1)[:, None] + (at * at).sum(axis=1) - 2 * to @ at.T
    leaving = np.maximum(facing @ to.T - (facing * at).sum(axis=1)[:, None], 0).T  # times the distance, as below
    arriving = np.maximum(towards @ at.T - (towards * to).sum(axis=1)[:, None], 0)
    form = leaving * arriving * area / (np.pi * np.maximum(squared, MIN_DISTANCE_MM**2) ** 2)
    light = (form @ sent).reshape(RECEIVERS, RECEIVERS, 3).astype(np.float32)
    return cv2.resize(light, (width, height), interpolation=cv2.INTER_LINEAR)


def _patch_areas(at: Floats, facing: Floats) -> Floats:
    """Wall area (S*S,) mm^2 behind each block of pixels: solid angle * distance^2 / cosine of the view."""
    distance = np.maximum(np.linalg.norm(at, axis=1), 1e-3)
    rays = (at / distance[:, None]).reshape(SOURCES, SOURCES, 3)
    solid = np.linalg.norm(np.gradient(rays, axis=0), axis=-1) * np.linalg.norm(np.gradient(rays, axis=1), axis=-1)
    cosine = -(facing * at).sum(axis=1) / distance
    return np.where(distance > 1, solid.ravel() * distance**2 / np.maximum(cosine, MIN_COSINE), 0)


def _coarse(field: Floats, side: int) -> Floats:
    """Means (side*side,3) of blocks of (H,W,3)."""
    return cv2.resize(field, (side, side), interpolation=cv2.INTER_AREA).reshape(-1, 3).astype(np.float32)
