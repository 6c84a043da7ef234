"""What a run is compared with: a truth that does not hold the wall that no frame saw says so."""

import numpy as np

from pipeline import compare
from reconstruction.mesh.mesh_io import write_mesh
from reconstruction.mesh.surface_mesh import SurfaceMesh


def test_coverage_cannot_be_compared_with_a_mesh_of_seen_wall_alone(tmp_path):
    assert compare._coverage(None, np.eye(4), tmp_path) is None  # no mesh at all
    write_mesh(SurfaceMesh.from_triangles(np.eye(3), [[0, 1, 2]]), tmp_path / "mesh.ply")
    assert "does not hold the wall that no frame saw" in compare._coverage(None, np.eye(4), tmp_path)
