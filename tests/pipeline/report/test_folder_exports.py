"""A run as other programs' folders, read by their libraries, or by the words of their documentation."""

import json
import subprocess
import sys
from pathlib import Path

import cv2
import jsonschema
import numpy as np
import pytest
import trimesh

from haustra.core.errors import HaustraError
from pipeline.cli import main as cli
from pipeline.finished_run import Run
from pipeline.report.exporters import export_folder
from pipeline.report.mesh_export import _rounded_up
from reconstruction.evaluation.trajectory_io import write_tum
from tests.helpers.tiny_run import MM, make_tiny_run

CODE = (
    "import cv2, json, pycolmap, sys; m = pycolmap.Reconstruction(sys.argv[1]);"
    "off = [float(abs(i.project_point(m.points3D[p.point3D_id].xyz) - p.xy).max())"
    " for i in m.images.values() for p in i.points2D];"
    "images = sorted(m.images.values(), key=lambda i: i.name);"
    "print(json.dumps([[i.name for i in images], [list(i.projection_center()) for i in images], len(off), max(off),"
    " [list(map(int, p.color)) for p in m.points3D.values()]]))"
)


def by_schema(name, told):
    """A program's schema beside this test, and that it can fail."""
    schema = json.loads(Path(__file__).with_name(f"{name}.schema.json").read_text())
    jsonschema.validate(told, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(told | {"misspelt": 1}, schema)


@pytest.fixture
def made(tmp_path, monkeypatch):
    made = make_tiny_run(tmp_path / "tiny", 20, 6)
    workspace = made.workspace
    workspace.masks.mkdir(exist_ok=True)
    for index in made.completed[0].submap.frames.tolist():
        mask = np.full((48, 48), 255, np.uint8)
        mask[:4] = 0
        cv2.imwrite(str(workspace.mask_path(index)), mask)
    submap = made.completed[0].submap.scaled(MM)
    write_tum(workspace.trajectory, submap.frames / 30, submap.world_from_camera)
    workspace.finish("surface")
    monkeypatch.setattr(Run, "surfaces", made.surfaces)
    monkeypatch.setattr(Run, "completed_submaps", made.completed)
    monkeypatch.setattr(Run, "metrics", made.metrics)
    monkeypatch.setattr(Run, "frames", made.frames)
    return made


def export(monkeypatch, made, target, *options):
    monkeypatch.setattr(sys, "argv", ["haustra", "export", str(made.workspace.root), str(target), *options])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    return stop.value.code or 0


def test_colmap_opens_its_folder_in_text_and_binary(made, tmp_path, monkeypatch, capsys):
    assert export(monkeypatch, made, tmp_path / "out", "--colmap") == 0
    model = tmp_path / "out/sparse/0"
    assert capsys.readouterr().out == f"{model}\n"
    both = [f"{name}{suffix}" for name in ("cameras", "images", "points3D") for suffix in (".txt", ".bin")]
    assert {path.name for path in model.iterdir()} == {*both, "rigs.bin", "frames.bin"}  # as docs/reference/cli.md says
    frames = made.completed[0].submap.frames.tolist()
    for gone in (".bin", ".txt"):  # the second time the other form is read
        done = subprocess.run([sys.executable, "-c", CODE, str(model)], capture_output=True, text=True, check=True)
        names, centres, count, off, colours = json.loads(done.stdout.splitlines()[-1])
        assert names == [f"{k:06d}.jpg" for k in frames]
        np.testing.assert_allclose(centres, MM * made.completed[0].submap.centres, atol=1e-6)
        assert count > 1000
        assert off < 1e-3
        assert np.ptp(colours, axis=0).min() > 20  # of the pictures, not grey
        for path in model.glob(f"*{gone}"):
            path.rename(path.with_suffix(f"{gone}.gone"))
        for path in model.glob("*.gone"):
            if not path.name.endswith(f"{gone}.gone"):
                path.rename(path.with_suffix(""))
    # gsplat pairs the model's names with the folder's files in order: there must be no others.
    assert sorted(path.name for path in (tmp_path / "out/images").iterdir()) == names
    assert cv2.imread(str(tmp_path / "out/masks" / f"{names[0]}.png"), cv2.IMREAD_GRAYSCALE)[:3].max() == 0
    assert export(monkeypatch, made, tmp_path / "out", "--colmap") == 1
    assert "is there already" in capsys.readouterr().err


def test_nerfstudio_by_its_conventions(made, tmp_path, monkeypatch):
    """Its camera looks along -z with y up; a point's pixel and depth follow from transforms.json alone."""
    assert export(monkeypatch, made, tmp_path / "out", "--nerfstudio") == 0
    told = json.loads((tmp_path / "out/transforms.json").read_text())
    by_schema("transforms", told)
    submap, frame = made.completed[0].submap, told["frames"][5]
    matrix = np.array(frame["transform_matrix"])
    np.testing.assert_allclose(np.linalg.det(matrix[:3, :3]), 1)
    seen = submap.observations[submap.observations[:, 0] == 5, 1]
    local = (MM * submap.points[seen] - matrix[:3, 3]) @ matrix[:3, :3]
    x = told["fl_x"] * local[:, 0] / -local[:, 2] + told["cx"]
    y = told["fl_y"] * local[:, 1] / local[:, 2] + told["cy"]
    np.testing.assert_allclose(np.stack([x, y], axis=1), submap.pixels[submap.observations[:, 0] == 5], atol=1e-6)
    depth = 1e-3 * np.load(tmp_path / "out" / frame["depth_file_path"])  # as nerfstudio scales it
    inside = (x > 0) & (y > 0) & (x < told["w"]) & (y < told["h"])
    there = depth[y[inside].astype(int), x[inside].astype(int)]
    assert np.median(np.abs(there / -local[inside, 2] - 1)) < 0.25  # the tiny run's depth is of a camera in the middle
    for part, shape in (("file_path", (48, 48, 3)), ("mask_path", (48, 48))):
        assert cv2.imread(str(tmp_path / "out" / frame[part]), cv2.IMREAD_UNCHANGED).shape == shape
    cloud = trimesh.load(tmp_path / "out" / told["ply_file_path"])
    radius = np.hypot(*np.asarray(cloud.vertices)[:, :2].T)
    np.testing.assert_allclose(np.median(radius), MM, rtol=0.01)


def test_slicer_by_its_schema(made, tmp_path, monkeypatch, capsys):
    """By markups-schema-v1.0.3, in LPS mm."""
    assert export(monkeypatch, made, tmp_path / "out", "--slicer") == 0
    kinds = {"path.mrk.json": "Curve", "missed_regions.mrk.json": "Fiducial"}
    for name, kind in kinds.items():
        told = json.loads((tmp_path / "out" / name).read_text())
        by_schema("markups", told)
        (markup,) = told["markups"]
        assert (markup["type"], markup["coordinateSystem"], markup["coordinateUnits"]) == (kind, "LPS", "mm")
        assert {point["positionStatus"] for point in markup["controlPoints"]} <= {"defined"}
    path = json.loads((tmp_path / "out/path.mrk.json").read_text())["markups"][0]["controlPoints"]
    np.testing.assert_allclose([point["position"] for point in path], MM * made.completed[0].submap.centres, atol=1e-6)
    assert b"comment SPACE=LPS" in (tmp_path / "out/mesh.ply").read_bytes()[:200]
    assert len(trimesh.load(tmp_path / "out/mesh.ply").faces) == len(made.surfaces[0].mesh.faces)


def test_a_region_all_round_has_no_hour_in_slicer(made, tmp_path, monkeypatch):
    (region,) = made.coverage[0].record["missed_regions"]
    monkeypatch.setattr(Run, "coverage", [{"missed_regions": [region | {"clock": None}]}])
    assert export(monkeypatch, made, tmp_path / "out", "--slicer") == 0
    (markup,) = json.loads((tmp_path / "out/missed_regions.mrk.json").read_text())["markups"]
    assert ", all round, " in markup["controlPoints"][0]["description"]


def test_a_run_without_scale_is_not_for_slicer(made, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(Run, "surfaces", made.surfaces[1:])
    assert export(monkeypatch, made, tmp_path / "out", "--slicer") == 1
    assert "has no scale" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("words", [["mesh.ply"], ["depth/x", "--colmap"], ["new.obj"]])
def test_nothing_is_exported_into_the_run(made, monkeypatch, capsys, words):
    before = sorted(path.name for path in made.workspace.root.rglob("*"))
    assert export(monkeypatch, made, made.workspace.root / words[0], *words[1:]) == 1
    assert "is inside the run folder" in capsys.readouterr().err
    assert sorted(path.name for path in made.workspace.root.rglob("*")) == before


def test_one_program_at_a_time(made, tmp_path, monkeypatch, capsys):
    assert export(monkeypatch, made, tmp_path / "out", "--slicer", "--colmap") == 1
    assert export(monkeypatch, made, tmp_path / "out", "--slicer", "--texture") == 1
    assert "give one of" in capsys.readouterr().err


def test_fewer_triangles_are_counted_and_so_is_none_fewer(made, tmp_path, monkeypatch, capsys):
    target, count = tmp_path / "light.ply", len(made.surfaces[0].mesh.faces)
    assert export(monkeypatch, made, target, "--max-error", "1e-9") == 0
    said = f"all {count} triangles are left, since none of half as many was found within 1e-09 mm"
    assert capsys.readouterr().out == f"{target}: {said}\n"
    assert export(monkeypatch, made, target, "--max-error", "1e9") == 0
    assert f" of {count} triangles, at most " in capsys.readouterr().out


def test_an_error_without_millimetres_is_in_scene_units(made, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(Run, "unit", lambda run: "scene")
    assert export(monkeypatch, made, tmp_path / "light.ply", "--max-error", "1e9") == 0
    assert capsys.readouterr().out.endswith(" scene units off\n")


def test_a_flat_mesh_loses_triangles_without_any_error():
    assert _rounded_up(0.0) == "0"
    assert _rounded_up(0.1231) == "0.13"


def test_a_file_where_a_climb_folder_is_to_be_is_named(made, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("pipeline.climb.loop_seconds", lambda run: 1.0)
    (tmp_path / "file").touch()
    assert export(monkeypatch, made, tmp_path / "file", "--climb") == 1
    assert capsys.readouterr().err == f"error: {tmp_path / 'file'} is a file; give a new or empty folder\n"


@pytest.mark.parametrize("there", [False, True])
def test_an_export_that_fails_leaves_nothing_in_the_way_of_the_next(made, tmp_path, monkeypatch, capsys, there):
    target, frames = tmp_path / "out", made.completed[0].submap.frames.tolist()
    if there:
        target.mkdir()
    lost = made.workspace.mask_path(frames[-1])
    mask = lost.read_bytes()
    lost.unlink()
    assert export(monkeypatch, made, target, "--nerfstudio") == 1
    assert "has lost its" in capsys.readouterr().err
    assert target.exists() == there
    assert not list(tmp_path.glob("out/*"))
    lost.write_bytes(mask)
    assert export(monkeypatch, made, target, "--nerfstudio") == 0
    assert export(monkeypatch, made, target, "--nerfstudio") == 1  # and what is whole is not touched
    assert (target / "transforms.json").is_file()


def test_an_export_that_fails_takes_the_folders_with_it_that_were_made_for_it(made, tmp_path):
    (tmp_path / "films").mkdir()
    made.workspace.mask_path(made.completed[0].submap.frames[-1]).unlink()
    with pytest.raises(HaustraError, match="has lost its"):
        export_folder(made.workspace.root, tmp_path / "films/one/out", "nerfstudio")
    assert not list((tmp_path / "films").iterdir())
