"""A small map of drawn points, on which every process does its work once before the film begins.

Compiled loops and libraries are loaded at their first use, which takes seconds: too long while frames come.
"""

import numpy as np

from haustra.core.camera import Camera
from haustra.core.ray_table import RayTable
from haustra.core.se3 import in_camera
from pipeline.live.live_tracking import SettledKeyframe
from pipeline.mapping.local_map import LocalMap
from pipeline.mapping.map_adjustment import adjust_window
from pipeline.mapping.submap_of_map import to_submap
from pipeline.optimization.resection import refine_pose, robust_pose

SIDE, POINTS, KEYFRAMES = 96, 120, 6
STEP = 0.06  # between keyframes, in units of the points' depth


def small_camera() -> Camera:
    return Camera("PINHOLE", SIDE, SIDE, (SIDE / 2, SIDE / 2, SIDE / 2, SIDE / 2), True)


def small_map() -> LocalMap:
    """Keyframes that move past points at about one unit's distance, adjusted."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-0.5, 0.8, (POINTS, 2)), rng.uniform(0.8, 1.6, POINTS)])
    local_map = LocalMap(RayTable(small_camera()))
    local_map.tracks.reserve(POINTS)
    for number in range(KEYFRAMES):
        camera_from_world = np.eye(4)
        camera_from_world[0, 3] = -STEP * number
        pixels = local_map.rays.project(in_camera(camera_from_world, points))
        seen = np.flatnonzero(((pixels > 1) & (pixels < SIDE - 1)).all(axis=1))
        local_map.add_keyframe(number, camera_from_world, seen, pixels[seen])
    local_map.triangulate_new()
    adjust_window(local_map)
    return local_map


def small_keyframes() -> list[SettledKeyframe]:
    """Two of them, as the tracker hands them on."""
    local_map = small_map()
    around = to_submap(local_map, small_camera().params, refit=False)
    assert around is not None
    rgb, mask = np.full((SIDE, SIDE, 3), 128, np.uint8), np.full((SIDE, SIDE), 255, np.uint8)
    return [SettledKeyframe(0, row, 0.0, rgb, mask, around, row) for row in (1, 3)]


def warm_tracking() -> None:
    """Load what the tracker needs."""
    local_map = small_map()
    keyframe = local_map.keyframes[-1]
    points, pixels = local_map.visible_points(keyframe)
    xy, jacobian = local_map.rays.unproject(pixels)
    refine_pose(keyframe.camera_from_world, points, xy, jacobian, 2.0)
    robust_pose(points, xy, jacobian, 2.0, np.random.default_rng(0))
    small_keyframes()
