"""Light that one wall sends to another.

The lamp sits beside the lens, so what it lights is what the camera sees: the picture itself is the map of light sources
(reflective shadow map, Dachsbacher & Stamminger 2005). Without occlusion between walls, and without the walls outside
of the picture.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating[Any]]
SOURCES, RECEIVERS = 16, 24  # per side; walls light each other smoothly
NEAREST_MM = 4.0  # closer, a patch is no point
STEEPEST = 0.15  # cosine; at grazing view a patch's area is anyone's guess


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
    form = leaving * arriving * area / (np.pi * np.maximum(squared, NEAREST_MM**2) ** 2)
    light = (form @ sent).reshape(RECEIVERS, RECEIVERS, 3).astype(np.float32)
    return cv2.resize(light, (width, height), interpolation=cv2.INTER_LINEAR)


def _patch_areas(at: Floats, facing: Floats) -> Floats:
    """Wall area (S*S,) mm^2 behind each block of pixels: solid angle * distance^2 / cosine of the view."""
    distance = np.maximum(np.linalg.norm(at, axis=1), 1e-3)
    rays = (at / distance[:, None]).reshape(SOURCES, SOURCES, 3)
    solid = np.linalg.norm(np.gradient(rays, axis=0), axis=-1) * np.linalg.norm(np.gradient(rays, axis=1), axis=-1)
    cosine = -(facing * at).sum(axis=1) / distance
    return np.where(distance > 1, solid.ravel() * distance**2 / np.maximum(cosine, STEEPEST), 0)


def _coarse(field: Floats, side: int) -> Floats:
    """Means (side*side,3) of blocks of (H,W,3)."""
    return cv2.resize(field, (side, side), interpolation=cv2.INTER_AREA).reshape(-1, 3).astype(np.float32)
