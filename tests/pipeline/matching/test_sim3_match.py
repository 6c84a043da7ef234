"""A verified match of two keyframes, against the motion that made them."""

import numpy as np
import pytest

from haustra.core.camera import Camera
from haustra.core.ray_table import RayTable
from pipeline.matching.keyframe_features import KeyframeFeatures
from pipeline.matching.sim3_match import candidate_rows, verify_match

CAMERA = Camera("PINHOLE", 320, 320, (160.0, 160.0, 160.0, 160.0))
RAYS = RayTable(CAMERA)
COUNT = 200


def views(shift_px: float) -> list[KeyframeFeatures]:
    """Features of a wall at depths 2 to 4 in two keyframes, the second moved sideways by so many pixels at depth 3."""
    rng = np.random.default_rng(0)
    points = rng.uniform([-1.5, -1.5, 2], [1.5, 1.5, 4], (COUNT, 3))
    descriptors = rng.integers(0, 255, (COUNT, 128)).astype(np.uint8)
    empty = np.zeros(COUNT, bool)
    found = []
    for moved in (points, points - [shift_px * 3 / 160, 0, 0]):
        found.append(KeyframeFeatures(0, CAMERA.project(moved), descriptors, moved, np.full(COUNT, 3.0), empty))
    return found


def match_of(shift_px, drop_static):
    pair = views(shift_px)
    rows = candidate_rows(*pair, drop_static)
    return verify_match((0, 1), *pair, (RAYS, RAYS), np.random.default_rng(0), rows)


@pytest.mark.parametrize("shift_px", [0.0, 0.5, 5.0])
def test_a_loop_may_end_in_the_very_view_where_it_began(shift_px):
    match = match_of(shift_px, drop_static=False)
    assert match is not None
    assert match.inliers > 0.9 * COUNT
    truth = np.eye(4)
    truth[0, 3] = shift_px * 3 / 160
    np.testing.assert_allclose(match.first_from_second, truth, atol=1e-3)


def test_what_stands_still_does_not_merge_submaps():
    assert match_of(0.0, drop_static=True) is None
    assert match_of(5.0, drop_static=True) is not None
