"""Corrections of parts and path against a drift that is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from haustra.core.se3 import inverse
from haustra.core.sim3 import transform_camera
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.rectification import make_rectifier
from pipeline.live.review_worker import _from_latest, corrections_of, path_of
from pipeline.live.surface_part import SurfacePart
from pipeline.live.warm_up import KEYFRAMES, small_camera, small_map
from pipeline.mapping.submap_of_map import to_submap


def part(number, first, last):
    empty = np.zeros((0, 3))
    return SurfacePart(number, 1, 0, (first, last), empty.astype(np.float32), empty.astype(np.uint32), empty, 0.01)


def test_a_part_moves_as_its_middle_keyframe_did_and_the_latest_stays():
    rng = np.random.default_rng(3)
    submap = to_submap(small_map(), small_camera().params, refit=False)
    rows = np.arange(KEYFRAMES)
    before = CompletedSubmap(submap, make_rectifier(small_camera()), rows, None)
    moves = []
    for _ in rows:
        move = np.eye(4)
        move[:3, :3] = rng.uniform(0.9, 1.1) * Rotation.random(random_state=rng).as_matrix()
        move[:3, 3] = rng.normal(size=3)
        moves.append(move)
    poses = [
        inverse(transform_camera(move, inverse(world_from_camera)))
        for move, world_from_camera in zip(moves, submap.world_from_camera, strict=True)
    ]
    scale = np.array([np.cbrt(np.linalg.det(move[:3, :3])) for move in moves])
    after = replace(before, submap=replace(submap, world_from_camera=np.stack(poses)), depth_scale=scale)
    found = corrections_of(before, after, (part(0, 0, 2), part(1, 3, 5)))
    np.testing.assert_allclose(found[0], moves[1], atol=1e-9)
    np.testing.assert_allclose(found[1], moves[4], atol=1e-9)
    shown = _from_latest(found)
    np.testing.assert_allclose(shown[1], np.eye(4), atol=1e-9)
    np.testing.assert_allclose(shown[0], np.linalg.inv(moves[4]) @ moves[1], atol=1e-9)
    path = np.array(path_of(after, found[1]))
    np.testing.assert_allclose(path[4], submap.world_from_camera[4, :3, 3], atol=1e-4)  # the latest part's stays
