"""The judge of closed mouths, on a plane with a pouch that is whole, hidden behind a lid, or left open."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.lids import judge_mouth, outward_axis
from reconstruction.mesh.surface_mesh import SurfaceMesh

RADIUS, DEPTH = 3.0, 6.0
GRID = np.arange(-12, 12.01, 0.4)


def sheet(depth_at) -> SurfaceMesh:
    """Triangles over a grid at z = depth_at(distance from the middle); where that is NaN there is a hole."""
    x, y = np.meshgrid(GRID, GRID)
    z = depth_at(np.hypot(x, y))
    count = len(GRID)
    corner = np.arange(count * count).reshape(count, count)[:-1, :-1].ravel()
    upper = np.stack([corner, corner + 1, corner + count], 1)
    lower = np.stack([corner + 1, corner + count + 1, corner + count], 1)
    faces = np.concatenate([upper, lower])
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    faces = faces[np.isfinite(vertices[faces, 2]).all(axis=1)]
    return SurfaceMesh.from_triangles(np.nan_to_num(vertices), faces)


WALL = sheet(lambda r: np.where(r < RADIUS, DEPTH, 0.0))
MESHES = {
    "pouch": (WALL, 0.0),
    "lid": (sheet(lambda r: 0.0 * r), 1.0),
    "lid within tolerance": (sheet(lambda r: np.where(r < RADIUS, 1.0, 0.0)), 1.0),
    "hole": (sheet(lambda r: np.where(r < RADIUS, np.nan, 0.0)), 0.0),
}


@pytest.mark.parametrize("name", MESHES)
def test_a_mouth_is_closed_by_a_lid_and_by_nothing_else(name: str) -> None:
    mesh, closed = MESHES[name]
    found = judge_mouth(mesh, WALL, np.zeros(3), RADIUS)
    assert found["judged"]
    assert found["closed_share"] == pytest.approx(closed, abs=0.05)


def test_the_axis_points_into_the_pouch() -> None:
    np.testing.assert_allclose(outward_axis(WALL, np.zeros(3), RADIUS), [0, 0, 1], atol=2e-3)


def test_a_mouth_without_wall_around_it_is_not_judged() -> None:
    bare = sheet(lambda r: np.where(r < 1.2 * RADIUS, 0.0, np.nan))
    assert not judge_mouth(bare, WALL, np.zeros(3), RADIUS)["judged"]


def test_a_mouth_that_is_shallow_in_truth_is_not_judged() -> None:
    shallow = sheet(lambda r: np.where(r < RADIUS, 2.0, 0.0))
    assert not judge_mouth(sheet(lambda r: 0.0 * r), shallow, np.zeros(3), RADIUS)["judged"]
