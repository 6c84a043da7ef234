"""Depth carried from view to view, against planes and spheres whose depth is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from reconstruction.fusion.depth_transfer import UnsureView, transferred

SIZE = 96
INTRINSICS = np.array([[80.0, 0, SIZE / 2], [0, 80.0, SIZE / 2], [0, 0, 1]])
CELL = 6


def world_from_camera(x: float = 0.0, y: float = 0.0, z: float = 0.0, turn_deg: float = 0.0) -> np.ndarray:
    found = np.eye(4)
    found[:3, :3] = Rotation.from_euler("y", turn_deg, degrees=True).as_matrix()
    found[:3, 3] = x, y, z
    return found


def rays() -> np.ndarray:
    """(H,W,3) with z = 1."""
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5
    return np.stack([(x - SIZE / 2) / 80, (y - SIZE / 2) / 80, np.ones_like(x)], axis=-1)


def plane_depth(world_from_camera: np.ndarray, normal: tuple[float, float, float], offset: float) -> np.ndarray:
    """z-depth (H,W) of the plane normal . x = offset."""
    direction = rays() @ world_from_camera[:3, :3].T
    depth = (offset - np.dot(normal, world_from_camera[:3, 3])) / (direction @ np.array(normal))
    return depth.astype(np.float32)


def view(world_from_camera: np.ndarray, depth: np.ndarray, error: float = 0.01) -> UnsureView:
    return UnsureView(depth.astype(np.float32), np.full(depth.shape, error, np.float32), INTRINSICS, world_from_camera)


WALL = (0.3, -0.2, 1.0), 20.0
POSES = [world_from_camera(2.0), world_from_camera(-1.5, 1.0, 2.0, 8.0), world_from_camera(0.5, -2.0, -1.0, -6.0)]


def test_a_plane_arrives_where_it_is_to_the_pixel_that_a_point_is_rounded_to() -> None:
    here = world_from_camera(0.4, 0.3, 0.5, 3.0)
    depth, error = transferred((SIZE, SIZE), INTRINSICS, here, [view(p, plane_depth(p, *WALL)) for p in POSES], CELL)
    found = depth > 0
    assert found.sum() > 0.8 * (SIZE / CELL) ** 2
    # A point anywhere in its pixel: half a pixel of this plane's slope.
    np.testing.assert_allclose(depth[found], plane_depth(here, *WALL)[found], rtol=0.006)
    assert (error[found] > 0).all()
    assert (error[~found] == 0).all()


def test_at_most_one_point_lies_in_a_cell() -> None:
    depth, _ = transferred(
        (SIZE, SIZE), INTRINSICS, world_from_camera(), [view(p, plane_depth(p, *WALL)) for p in POSES], CELL
    )
    cells = (depth > 0).reshape(SIZE // CELL, CELL, SIZE // CELL, CELL).sum(axis=(1, 3))
    assert cells.max() == 1


def test_views_that_agree_are_surer_than_one_and_never_surer_than_two_independent_ones() -> None:
    def median_error(count: int) -> float:
        views = [
            view(world_from_camera(0.1 * k), plane_depth(world_from_camera(0.1 * k), (0.0, 0.0, 1.0), 20.0))
            for k in range(count)
        ]
        error = transferred((SIZE, SIZE), INTRINSICS, world_from_camera(), views, CELL)[1]
        return float(np.median(error[error > 0]))

    assert median_error(1) == pytest.approx(0.01, rel=1e-3)
    assert median_error(2) == pytest.approx(0.01 / np.sqrt(2), rel=1e-2)
    assert median_error(8) == pytest.approx(0.01 / np.sqrt(2), rel=1e-2)


def test_a_view_that_disagrees_loses_to_the_majority_and_leaves_doubt() -> None:
    good = [
        view(world_from_camera(0.1 * k), plane_depth(world_from_camera(0.1 * k), (0.0, 0.0, 1.0), 20.0))
        for k in range(3)
    ]
    wild = view(world_from_camera(), plane_depth(world_from_camera(), (0.0, 0.0, 1.0), 30.0))
    depth, error = transferred((SIZE, SIZE), INTRINSICS, world_from_camera(), [*good, wild], CELL)
    alone = transferred((SIZE, SIZE), INTRINSICS, world_from_camera(), good, CELL)[1]
    inner = np.s_[12:-12, 12:-12]
    found = depth[inner] > 0
    np.testing.assert_allclose(depth[inner][found], 20.0, rtol=0.01)
    assert np.median(error[error > 0]) > 1.1 * np.median(alone[alone > 0])


def test_a_near_wall_hides_a_far_one_of_the_same_view() -> None:
    """The left half of another view is at 10, the right at 30: from the left, the near half covers part of the far."""
    depth = np.where(np.arange(SIZE)[None] < SIZE // 2, 10.0, 30.0) * np.ones((SIZE, 1))
    here = world_from_camera(-3.0)
    got, _ = transferred((SIZE, SIZE), INTRINSICS, here, [view(world_from_camera(), depth)], CELL)
    # The near half's right edge, at x = 0, z = 10, is seen at 80 * 3 / 10 px right of the middle.
    edge = SIZE / 2 + 80 * 3.0 / 10
    columns = np.nonzero(got)[1]
    values = got[got > 0]
    assert np.allclose(values[columns < edge - CELL], 10.0)
    assert np.allclose(values[columns > edge + CELL], 30.0)


def test_what_lies_behind_or_outside_is_left_out_and_nothing_comes_of_nothing() -> None:
    back = world_from_camera(turn_deg=180.0)
    depth = plane_depth(world_from_camera(), (0.0, 0.0, 1.0), 20.0)
    assert not transferred((SIZE, SIZE), INTRINSICS, world_from_camera(), [view(back, depth)], CELL)[0].any()
    assert not transferred((SIZE, SIZE), INTRINSICS, world_from_camera(), [], CELL)[0].any()
    assert not transferred((SIZE, SIZE), INTRINSICS, world_from_camera(), [view(world_from_camera(), 0 * depth)], CELL)[
        0
    ].any()


def test_a_scale_of_the_scene_scales_the_depth_and_leaves_the_errors() -> None:
    def run(scale: float) -> tuple[np.ndarray, np.ndarray]:
        scaled = [p.copy() for p in POSES]
        for p in scaled:
            p[:3, 3] *= scale
        views = [view(p, plane_depth(p, WALL[0], WALL[1] * scale)) for p in scaled]
        return transferred((SIZE, SIZE), INTRINSICS, world_from_camera(), views, CELL)

    (one, error), (eight, error_of_eight) = run(1.0), run(8.0)  # a power of two: no point changes its pixel by rounding
    np.testing.assert_allclose(eight, 8 * one, rtol=1e-6)
    np.testing.assert_allclose(error_of_eight, error, rtol=1e-5)
