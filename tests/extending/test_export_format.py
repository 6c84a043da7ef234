"""The export formats of docs/extending.md, through `haustra export` on a finished run."""

import sys

import numpy as np
import pytest
import trimesh

from pipeline.cli import main as cli
from pipeline.finished_run import Run
from pipeline.report.exporters import EXPORTERS
from reconstruction.evaluation.trajectory_io import write_tum
from reconstruction.mesh.formats import MESH_FORMATS, MeshFormat
from reconstruction.mesh.mesh_io import read_mesh
from tests.helpers.recipes import add_row, written
from tests.helpers.tiny_run import make_tiny_run


@pytest.fixture
def made(tmp_path, monkeypatch):
    made = make_tiny_run(tmp_path / "tiny", 20, 6)
    made.workspace.finish("surface")
    monkeypatch.setattr(Run, "surfaces", made.surfaces)
    return made


def haustra(monkeypatch, *words):
    monkeypatch.setattr(sys, "argv", ["haustra", *map(str, words)])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    return stop.value.code or 0


def test_a_mesh_is_exported_by_its_row(made, tmp_path, monkeypatch, capsys):
    target = tmp_path / "out.off"
    assert haustra(monkeypatch, "export", made.workspace.root, target) == 1
    told = capsys.readouterr().err
    assert told.startswith("error: out.off: a run is exported as ")
    assert all(suffix in told for suffix in (*MESH_FORMATS, *EXPORTERS))
    written("reconstruction/mesh/formats/off.py", monkeypatch)
    path = "reconstruction/mesh/formats/registry.py"
    assert add_row(MESH_FORMATS, path, monkeypatch, {"MeshFormat": MeshFormat}) == ".off"
    assert haustra(monkeypatch, "export", made.workspace.root, target) == 0
    assert capsys.readouterr().out == f"{target}\n"
    mesh = made.surfaces[0].mesh
    theirs = trimesh.load(target, process=False)
    np.testing.assert_allclose(theirs.vertices, mesh.vertices, rtol=1e-7, atol=1e-12)
    np.testing.assert_array_equal(theirs.faces, mesh.faces)
    assert len(read_mesh(target).faces) == len(mesh.faces)
    assert haustra(monkeypatch, "export", made.workspace.root, target, "--texture") == 1
    assert "a texture goes into .glb or .obj" in capsys.readouterr().err
    assert haustra(monkeypatch, "compare", made.workspace.root, target) == 1


def test_a_whole_run_is_exported_by_its_row(made, tmp_path, monkeypatch, capsys):
    written("pipeline/report/csv_path.py", monkeypatch)
    assert add_row(EXPORTERS, "pipeline/report/exporters.py", monkeypatch) == ".csv"
    submap = made.completed[0].submap.scaled(made.surfaces[0].scale.factor)
    write_tum(made.workspace.trajectory, submap.frames / 30, submap.world_from_camera)
    target = tmp_path / "path.CSV"
    assert haustra(monkeypatch, "export", made.workspace.root, target) == 0
    assert capsys.readouterr().out == f"{target}\n"
    first, *_ = target.read_text().splitlines()
    assert first == "seconds,x,y,z  # mm"
    table = np.loadtxt(target, delimiter=",", skiprows=1)
    np.testing.assert_allclose(table, np.column_stack([submap.frames / 30, submap.centres]), atol=1e-6)
    for option in (("--texture",), ("--max-error", 1)):
        assert haustra(monkeypatch, "export", made.workspace.root, target, *option) == 1
        told = capsys.readouterr().err
        assert told.startswith("error: path.CSV: --max-error and --texture are for ")
        assert all(suffix in told for suffix in MESH_FORMATS)


def test_help_lists_both_tables(monkeypatch, capsys):
    monkeypatch.setitem(MESH_FORMATS, ".toymesh", MESH_FORMATS[".stl"])
    monkeypatch.setitem(EXPORTERS, ".toyrun", EXPORTERS[".rrd"])
    assert haustra(monkeypatch, "export", "--help") == 0
    told = capsys.readouterr().out
    assert all(suffix in told for suffix in (".ply", ".rrd", ".toymesh", ".toyrun"))
