"""Depth support of a surface: a screen before a wall, seen by some depth maps and looked past by others."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from reconstruction.coverage import depth_support
from reconstruction.coverage.depth_support import DEPTH_TOLERANCE, DepthSupport
from reconstruction.mesh.surface_mesh import SurfaceMesh


def screen_before_wall():
    """A wall at z = 30 and a small screen at 20 before it, its 441 vertices last; intrinsics; the wall's depth."""
    x, y = np.meshgrid(np.linspace(-10, 10, 21), np.linspace(-10, 10, 21))
    grid = np.stack([x, y], -1).reshape(-1, 2)
    cell = np.arange(20 * 21).reshape(20, 21)[:, :-1].ravel()
    faces = np.concatenate([np.stack([cell, cell + 21, cell + 1], 1), np.stack([cell + 1, cell + 21, cell + 22], 1)])
    wall, screen = np.column_stack([grid, np.full(441, 30.0)]), np.column_stack([0.2 * grid, np.full(441, 20.0)])
    mesh = SurfaceMesh.from_triangles(np.concatenate([wall, screen]), np.concatenate([faces, faces + 441]))
    return mesh, np.array([[50.0, 0, 40], [0, 50.0, 40], [0, 0, 1]]), np.full((80, 80), 30, np.float32)


def test_a_wall_that_other_frames_look_through_is_not_supported():
    """Two of three depth maps see past the screen."""
    mesh, intrinsics, far = screen_before_wall()
    support = DepthSupport(mesh)
    near = far.copy()
    near[34:46, 34:46] = 20
    for depth in (near, far, far):
        support.add(depth, np.ones((80, 80), np.float32), intrinsics, np.eye(4))
    np.testing.assert_allclose(support.contradiction[441:], 2 / 3, atol=1e-6)
    assert support.contradiction[:441].max() == 0
    assert support.best_cosine[220] == pytest.approx(1.0)
    supported = support.supported_faces()
    assert (supported.vertices[:, 2] == 30).all()
    assert len(supported.faces) == len(mesh.faces) // 2


@pytest.mark.parametrize(("off_px", "contradicted"), [(1, 0), (3, 2)])
def test_an_edge_that_a_frame_meets_a_pixel_off_is_supported(off_px, contradicted):
    """The screen's first column falls on pixel 35, where a frame that is `off_px` wrong sees the wall behind."""
    mesh, intrinsics, far = screen_before_wall()
    support = DepthSupport(mesh)
    for first in (35, 35 + off_px):
        depth = far.copy()
        depth[34:46, first:46] = 20
        depth[:, 47:] = 0  # unknown pixels say nothing
        support.add(depth, np.ones((80, 80), np.float32), intrinsics, np.eye(4))
    column = np.floor(support._mesh.vertices[441:, 0] * 50 / 20 + 40)
    doubted = np.unique(column[support.contradiction[441:] > 0])
    assert len(doubted) == contradicted
    assert (doubted == np.arange(35, 35 + contradicted)).all()


@pytest.mark.parametrize("few", [depth_support.FEW, 100])
def test_votes_are_those_of_the_same_rule_over_whole_arrays(few, monkeypatch):
    """Cameras turned and moved, some of the surface behind them or beside the picture, confidence with zeros."""
    monkeypatch.setattr(depth_support, "FEW", few)  # one thread, and two
    rng = np.random.default_rng(0)
    mesh, intrinsics, far = screen_before_wall()
    support, supporting, through, best = DepthSupport(mesh), *np.zeros((3, len(mesh.vertices)))
    for _ in range(20):
        world_from_camera = np.eye(4)
        world_from_camera[:3, :3] = Rotation.from_rotvec(rng.normal(0, 0.5, 3)).as_matrix()
        world_from_camera[:3, 3] = rng.normal(0, 12, 3)
        depth = (far * rng.uniform(0.5, 1.1) * (rng.random((80, 80)) > 0.02)).astype(np.float32)
        confidence = (rng.random((80, 80)) * (rng.random((80, 80)) > 0.1)).astype(np.float32)
        support.add(depth, confidence, intrinsics, world_from_camera)

        local = (mesh.vertices - world_from_camera[:3, 3]) @ world_from_camera[:3, :3]
        x, y = np.floor(local[:, :2] / np.where(local[:, 2:] > 0, local[:, 2:], np.nan) * 50 + 40).T
        rows = np.flatnonzero((x >= 0) & (x < 80) & (y >= 0) & (y < 80))
        row, column, z = y[rows].astype(int), x[rows].astype(int), local[rows, 2]
        weight = confidence[row, column] * (depth[row, column] > 0)
        holed = np.pad(np.where(depth > 0, depth, np.inf), 1, mode="edge")
        nearest = np.min([holed[a : a + 80, b : b + 80] for a in range(3) for b in range(3)], axis=0)
        agrees = weight * (np.abs(depth[row, column] - z) <= DEPTH_TOLERANCE * z)
        supporting[rows] += agrees
        through[rows] += weight * (nearest[row, column] - z > DEPTH_TOLERANCE * z)
        facing = -(local[rows] * (mesh.normals[rows] @ world_from_camera[:3, :3])).sum(axis=1)
        cosine = np.where(agrees > 0, facing / np.linalg.norm(local[rows], axis=1), 0.0)
        best[rows] = np.maximum(best[rows], cosine)
    assert ((supporting > 0) & (through > 0)).sum() > 50
    np.testing.assert_allclose(
        support.contradiction,
        np.where(supporting + through > 0, through / np.maximum(supporting + through, 1e-9), 1.0),
        atol=1e-6,
    )
    np.testing.assert_allclose(support.best_cosine, best, atol=1e-9)
