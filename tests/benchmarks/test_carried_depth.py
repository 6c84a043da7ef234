"""Depth of moved walls against planes that are known in closed form."""

import numpy as np
import pytest

from benchmarks.common.carried_depth import carried, points_of

K = np.array([[80.0, 0, 60.0], [0, 80.0, 45.0], [0, 0, 1]])
SHAPE = (90, 120)
INNER = (slice(25, -25), slice(25, -25))


def rays():
    row, column = np.indices(SHAPE)
    return np.stack([(column + 0.5 - 60) / 80, (row + 0.5 - 45) / 80, np.ones(SHAPE)], axis=-1)


def plane_depth(normal, distance):
    """z-depth (H,W) of the plane normal . x = distance."""
    return (distance / (rays() @ np.asarray(normal, float))).astype(np.float32)


NORMAL = np.array([0.3, -0.2, 1.0])


@pytest.mark.parametrize("shift", [(0, 0, 0), (0, 0, 1.5), (1.2, 0, 0), (-0.7, 0.9, -1.0)])
def test_a_shifted_plane_is_the_plane_farther_along_its_normal(shift):
    before = plane_depth(NORMAL, 12.0)
    found = carried(before, np.broadcast_to(np.float32(shift), (*SHAPE, 3)), K)
    expected = plane_depth(NORMAL, 12.0 + NORMAL @ np.array(shift))
    assert np.allclose(found.depth[INNER], expected[INNER], rtol=2e-3)


def test_a_picture_moves_with_its_wall():
    depth, shift = np.full(SHAPE, 10.0, np.float32), np.float32([1.0, 0, 0])  # 8 px to the right
    found = carried(depth, np.broadcast_to(shift, (*SHAPE, 3)), K)
    columns = np.broadcast_to(np.arange(120, dtype=np.float32), SHAPE).copy()
    assert np.allclose(found.image(columns)[INNER], columns[INNER] - 8, atol=1e-2)


def test_a_bulge_is_found_again_by_its_own_points():
    depth = np.full(SHAPE, 10.0, np.float32)
    points = points_of(depth, K)
    offsets = np.zeros((*SHAPE, 3), np.float32)
    offsets[..., 2] = -2 * np.exp(-(points[..., 0] ** 2 + points[..., 1] ** 2) / 8)
    found = points_of(carried(depth, offsets, K).depth, K)
    expected = 10 - 2 * np.exp(-(found[..., 0] ** 2 + found[..., 1] ** 2) / 8)
    assert np.allclose(found[..., 2][INNER], expected[INNER], atol=0.02)


def test_what_was_not_seen_is_not_made_up():
    depth = np.full(SHAPE, 10.0, np.float32)
    depth[40:50, 50:70] = 0
    found = carried(depth, np.broadcast_to(np.float32([1.0, 0, 0]), (*SHAPE, 3)), K).depth
    assert not found[40:50, 59:77].any()  # the hole moved by 8 px
    assert found[60:70, 59:77].all()
    assert not found[:, :7].any()  # nobody saw what came in at the left


def test_the_edge_between_two_walls_is_left_out():
    depth = np.full(SHAPE, 10.0, np.float32)
    depth[:, 60:] = 20
    found = carried(depth, np.zeros((*SHAPE, 3), np.float32), K).depth
    assert set(np.unique(found)) <= {0.0, 10.0, 20.0}
