"""A phantom small enough for tests, and plain ray-triangle algebra to check it with."""

from __future__ import annotations

import numpy as np

from haustra.phantom.config import (
    AnatomyConfig,
    AppearanceConfig,
    CameraConfig,
    ImagingConfig,
    MotionConfig,
    PhantomConfig,
)
from haustra.phantom.imaging.camera import Camera
from haustra.phantom.imaging.render import Phantom

SIZE = 48
TINY = PhantomConfig(
    seed=5,
    anatomy=AnatomyConfig(length_mm=110.0, radius_mm=14.0, fold_depth_mm=4.0, edge_mm=2.0, polyps=2, flexures=0),
    appearance=AppearanceConfig(texel_mm=0.4, tree_width_mm=1.0),
    imaging=ImagingConfig(noise=0.0, specular=0.0, light_offset_mm=0.0, lights=1, exposure_smoothing=0.95),
    camera=CameraConfig(width=SIZE, height=SIZE),
    motion=MotionConfig(frames=4, start=0.55, speed_mm=1.0, wobble_mm=1.0),
)


def first_hit(origin: np.ndarray, direction: np.ndarray, corners: np.ndarray) -> tuple[float, int]:
    """Moeller-Trumbore against every triangle (F,3,3): length to the nearest in units of direction, and which."""
    a, edge1, edge2 = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(direction, edge2)
    determinant = np.sum(edge1 * p, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        s = origin - a
        u = np.sum(s * p, axis=1) / determinant
        q = np.cross(s, edge1)
        v = q @ direction / determinant
        t = np.sum(edge2 * q, axis=1) / determinant
    t[~((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0))] = np.inf
    return float(t.min()), int(t.argmin())


def pixel_direction(camera: Camera, row: int, column: int) -> np.ndarray:
    """Direction with z = 1, so that lengths along it are z-depths. Pixel centres are at half integers."""
    fx, fy, cx, cy = camera.params
    return np.array([(column + 0.5 - cx) / fx, (row + 0.5 - cy) / fy, 1.0])


def corners_of(phantom: Phantom) -> np.ndarray:
    return phantom.colon.vertices[phantom.colon.triangles].astype(float)
