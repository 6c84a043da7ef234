"""What a run is compared with: a truth that does not hold the wall that no frame saw says so."""

import numpy as np
import pytest
import trimesh

from haustra.core.errors import HaustraError
from pipeline import compare
from reconstruction.mesh.mesh_io import write_mesh
from reconstruction.mesh.surface_mesh import SurfaceMesh


def test_coverage_cannot_be_compared_with_a_mesh_of_seen_wall_alone(tmp_path):
    assert compare._coverage(None, np.eye(4), tmp_path) is None  # no mesh at all
    write_mesh(SurfaceMesh.from_triangles(np.eye(3), [[0, 1, 2]]), tmp_path / "mesh.ply")
    assert "does not hold the wall that no frame saw" in compare._coverage(None, np.eye(4), tmp_path)


@pytest.mark.parametrize("tau", [0.2, 0.5, 1.0, 3.0])
def test_a_perfect_surface_is_perfect_at_every_distance(tmp_path, tau):
    ball = trimesh.creation.icosphere(subdivisions=3, radius=6)
    mesh = SurfaceMesh.from_triangles(np.asarray(ball.vertices), np.asarray(ball.faces))
    write_mesh(mesh, tmp_path / "mesh.ply")
    truth = compare._true_surface(tmp_path, compare.spacing_of(tau))
    errors = compare._surface(mesh, np.eye(4), truth, tau)
    assert min(errors.precision, errors.recall) > 0.99


def test_a_distance_finer_than_the_truth_can_be_is_refused_where_there_is_a_surface(tmp_path):
    path = tmp_path / "trajectory.txt"
    path.write_text("0 0 0 0 0 0 0 1\n")
    assert compare._true_surface(path, compare.spacing_of(0.1)) is None
    with pytest.raises(HaustraError, match=r"F-score at 0\.1 mm cannot be measured"):
        compare._true_surface(tmp_path, compare.spacing_of(0.1))
