"""What a run is compared with: a truth that does not hold the wall that no frame saw says so."""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from haustra.core.errors import HaustraError
from pipeline import compare
from reconstruction.evaluation.trajectory_io import write_tum
from reconstruction.mesh.mesh_io import write_mesh
from reconstruction.mesh.surface_mesh import SurfaceMesh


def test_coverage_cannot_be_compared_with_a_mesh_of_seen_wall_alone(tmp_path):
    assert compare._coverage(None, np.eye(4), tmp_path) is None  # no mesh at all
    write_mesh(SurfaceMesh.from_triangles(np.eye(3), [[0, 1, 2]]), tmp_path / "mesh.ply")
    assert "does not hold the wall that no frame saw" in compare._coverage(None, np.eye(4), tmp_path)


def test_true_coverage_is_compared_where_the_truth_has_no_depth(tmp_path, monkeypatch):
    """C3VD's coverage mesh knows which wall was seen, with or without the depth images."""
    rng = np.random.default_rng(0)
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, :3, 3] = rng.normal(size=(5, 3))
    run = SimpleNamespace(
        metrics={"submaps": [{"unit": "scene"}], "frames": {"posed": 5, "total": 5}},
        trajectory=lambda: (np.arange(5.0), poses),
        submaps=[None],
        mesh=tmp_path / "mesh.ply",
    )
    monkeypatch.setattr(compare, "open_run", lambda _: run)
    monkeypatch.setattr(compare, "_coverage", lambda *_: "asked")
    write_tum(tmp_path / "truth.tum", np.arange(5.0), poses)
    found = compare.compare_run(tmp_path, tmp_path / "truth.tum")
    assert (found.surface, found.coverage) == (None, "asked")


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
