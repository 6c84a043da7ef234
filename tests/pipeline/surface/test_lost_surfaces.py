"""A finished surface whose mesh was lost is no longer done."""

import pytest

from pipeline.run_folder.workspace import Workspace
from pipeline.surface.fusion_stage import forget_lost_surfaces, mesh_path
from reconstruction.mesh.mesh_io import write_mesh
from reconstruction.mesh.surface_mesh import SurfaceMesh

STAGES = ("depth", "surface", "coverage", "report")
SURFACE = {"factor": 1.0, "unit": "scene", "origin": "none", "voxel_size": 0.1, "dropped_share": 0.0, "lamp": None}


@pytest.fixture
def workspace(tmp_path):
    """Of a finished run of two submaps."""
    made = Workspace(tmp_path)
    triangle = SurfaceMesh.from_triangles([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    for number in range(2):
        write_mesh(triangle, mesh_path(made, number))
    for stage in STAGES:
        made.finish(stage, **({"surfaces": [SURFACE, SURFACE]} if stage == "surface" else {}))
    return made


def test_whole_meshes_stay(workspace):
    forget_lost_surfaces(workspace)
    assert list(workspace.record["stages"]) == list(STAGES)
    assert not workspace.made_anew


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("data", [None, b"", b"ply\nformat ascii", "half"])
def test_a_lost_or_damaged_one_is_made_anew_with_what_follows(workspace, number, data):
    path = mesh_path(workspace, number)
    if data is None:
        path.unlink()
    else:
        path.write_bytes(path.read_bytes()[: path.stat().st_size * 3 // 4] if data == "half" else data)
    forget_lost_surfaces(workspace)
    assert list(workspace.record["stages"]) == ["depth"]
    assert path.name in workspace.made_anew
