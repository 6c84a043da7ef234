"""A phantom small enough for tests, and plain ray-triangle algebra to check it with."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

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


def depth_errors(
    folder: Path, frame: int, camera: Camera, pixels: np.ndarray, corners: np.ndarray, rest: np.ndarray
) -> tuple[list[float], list[float]]:
    """How far a frame's stored depth is, at pixels (N,2) of row and column, from that of triangles (F,3,3), and from
    that of the triangles at rest, mm; no depth counts as 0."""
    depth = cv2.imread(str(folder / "depth" / f"{frame:05d}.png"), cv2.IMREAD_UNCHANGED) * 0.01
    row = np.loadtxt(folder / "trajectory.txt")[frame]
    rotation = Rotation.from_quat(row[4:]).as_matrix()
    errors, moved_by = [], []
    for r, c in pixels:
        direction = rotation @ pixel_direction(camera, r, c)
        z, _ = first_hit(row[1:4], direction, corners)
        errors.append(abs(depth[r, c] - (z if np.isfinite(z) else 0.0)))
        moved_by.append(abs(depth[r, c] - first_hit(row[1:4], direction, rest)[0]))
    return errors, moved_by
