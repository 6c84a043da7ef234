"""A tube's map along its axis, in a unit and with a bend of its scale, and a sensor that saw the tube."""

import numpy as np

from haustra.core.camera import Camera
from haustra.core.ray_table import RayTable
from haustra.core.se3 import in_camera, inverse
from pipeline.mapping.local_map import LocalMap

CAMERA = Camera("PINHOLE", 320, 320, (160.0, 160.0, 160.0, 160.0))
COUNT, STEP_MM, RADIUS_MM, UNIT = 24, 3.0, 20.0, 7.0


def world_from_camera_at(k: int) -> np.ndarray:
    found = np.eye(4)
    found[:3, 3] = 2 * np.sin(0.5 * k), 2 * np.cos(0.4 * k), STEP_MM * k
    return found


def tube(seed: int = 0, bend: float = 0.0, unit: float = UNIT) -> tuple[LocalMap, np.ndarray]:
    """A tube's map along its axis whose scale grows by `bend` to its end, and the true points in mm."""
    rng = np.random.default_rng(seed)
    angle, along = rng.uniform(0, 2 * np.pi, 1500), rng.uniform(0, STEP_MM * COUNT + 60, 1500)
    points = np.column_stack([RADIUS_MM * np.cos(angle), RADIUS_MM * np.sin(angle), along])
    stretch = lambda z: 1 + bend * z / (STEP_MM * COUNT)  # noqa: E731
    local_map = LocalMap(RayTable(CAMERA))
    local_map.tracks.reserve(len(points))
    local_map.tracks.points[: len(points)] = points * stretch(points[:, 2:]) / unit
    local_map.tracks.has_point[: len(points)] = True
    for k in range(COUNT):
        local = in_camera(inverse(world_from_camera_at(k)), points)
        seen = np.flatnonzero((local[:, 2] > 12) & (local[:, 2] < 60))
        pixels = CAMERA.project(local[seen])
        inside = ((pixels > 2) & (pixels < 318)).all(axis=1)
        moved = world_from_camera_at(k)
        moved[:3, 3] *= stretch(moved[2, 3]) / unit
        noisy = pixels[inside] + rng.normal(0, 0.2, (int(inside.sum()), 2))
        local_map.add_keyframe(k, inverse(moved), seen[inside], noisy)
    return local_map, points


def sensed(points: np.ndarray, noise: float, scale: float = 1.0):
    """A sensor that finds the depth of the true point nearest to a pixel, with noise; none in a tenth of the places."""

    def depth_at(frame: int, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rng = np.random.default_rng([frame, len(pixels)])
        local = in_camera(inverse(world_from_camera_at(frame)), points)
        local = local[(local[:, 2] > 12) & (local[:, 2] < 60)]
        off = np.linalg.norm(CAMERA.project(local)[None] - pixels[:, None], axis=2)
        depth = scale * local[off.argmin(axis=1), 2] * (1 + noise * rng.normal(size=len(pixels)))
        depth[rng.random(len(pixels)) < 0.1] = 0
        return depth, noise * depth

    return depth_at
