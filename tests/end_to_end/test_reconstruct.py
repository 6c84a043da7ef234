"""From a tiny phantom's video to a surface: the whole command, what it leaves, and going on after a stop."""

import json
import re
import shutil
import sys
from contextlib import contextmanager
from dataclasses import replace

import cv2
import numpy as np
import psutil
import pytest
import yaml

from benchmarks.common.recompletion import completed_from
from completion.inference.completer import DepthCompleter
from haustra.core.camera import read_camera
from haustra.core.errors import HaustraError, ReconstructionError
from haustra.core.progress import SilentProgress
from pipeline.cli import main as cli
from pipeline.compare import compare_run
from pipeline.config import load_config
from pipeline.demo import CAMERA, FOLDER, VIDEO
from pipeline.depth import multiview_stage
from pipeline.depth.completion_stage import load_completed
from pipeline.depth.photometric_points import photometric_points
from pipeline.depth.sparse_depth import SparseDepth, SparseDepthMaker
from pipeline.finished_run import open_run
from pipeline.frontend.points_stage import load_points
from pipeline.frontend.structure_stage import load_structure
from pipeline.input.frames import load_frames
from pipeline.run import reconstruct
from pipeline.run_folder.subprocesses import run_isolated
from pipeline.run_folder.workspace import open_workspace
from pipeline.surface import fusion_stage as surface
from pipeline.surface.scale import ScaleSource

ARTEFACTS = [
    *("run.yaml", "camera.json", "lens.json", "frames.json", "trajectory.tum", "keyframes.tum", "mesh.ply", "mesh.glb"),
    *("metrics.json", "report.html", "sparse/0/cameras.bin", "sparse/0/images.bin", "sparse/0/points3D.bin"),
]


def tiny_config(**changes):
    """The first 26 frames of the embedded clip, every second one used, by COLMAP."""
    settings = {"camera": str(CAMERA), "frames": {"end_s": 0.86, "stride": 2}, "lumen_mm": 40.0, "front_end": "sfm"}
    return load_config(None, **(settings | changes))


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "tiny"
    return folder, reconstruct(VIDEO, folder, tiny_config(), profile=True)


def test_every_artefact_of_the_contract_is_there(finished):
    folder, result = finished
    assert [name for name in ARTEFACTS if not (folder / name).exists()] == []
    assert (folder / "coverage.png").exists() == result.metrics["submaps"][0]["coverage"]["judged"]
    assert read_camera(folder / "lens.json") == read_camera(CAMERA)
    keyframes = result.metrics["submaps"][0]["keyframes"]
    assert len(list((folder / "depth").glob("*.png"))) == keyframes >= 5
    assert len(list((folder / "confidence").glob("*.png"))) == keyframes
    record = yaml.safe_load((folder / "run.yaml").read_text())
    stages = "frames structure points depth multiview motion surface coverage report"  # COLMAP's map is not refined
    assert set(record["stages"]) == set(stages.split())
    entry = record["submaps"][0]
    assert entry["unit"] == "mm"
    first = entry["keyframes"][0]
    steps = cv2.imread(str(folder / "depth" / f"{first:06d}.png"), cv2.IMREAD_UNCHANGED)
    assert 5 < np.median(steps * entry["depth_png_step"]) < 80


def test_a_profile_names_every_stage_and_is_on_the_page(finished):
    folder, result = finished
    profile = result.metrics["profile"]
    until_depth, after = "frames, structure, points, depth", "loop closing, motion, surface, coverage, files, report"
    assert ", ".join(one["stage"] for one in profile) == f"{until_depth}, depth from several views, {after}"
    assert all(one["seconds"] >= 0 and one["cpu_seconds"] >= 0 for one in profile)
    assert "time of stage: surface" in (folder / "report.html").read_text()


def test_a_run_reads_back_as_it_was_returned(finished):
    folder, result = finished
    run = open_run(folder)
    assert run.metrics == result.metrics
    assert run.unit() == "mm"
    seconds, world_from_camera = run.trajectory()
    assert len(seconds) == len(world_from_camera) == run.metrics["frames"]["posed"]
    keyframes = list(run.keyframes())
    assert len(keyframes) == run.metrics["submaps"][0]["keyframes"]
    for keyframe in keyframes:
        nearest = int(np.abs(seconds - keyframe.seconds).argmin())
        np.testing.assert_allclose(keyframe.world_from_camera, world_from_camera[nearest], atol=1e-5)
        sparse, error = keyframe.sparse.maps(*keyframe.depth.shape)
        both = (sparse > 0) & (keyframe.depth > 0)
        assert np.median(np.abs(np.log(sparse[both] / keyframe.depth[both]))) < 0.1
        assert (error[both] > 0).all()
    with pytest.raises(HaustraError, match=r"has 1 submap, numbered from 0; there is no 3"):
        run.trajectory(3)
    with pytest.raises(HaustraError, match="no 3"):
        next(run.keyframes(3))


def test_depth_completed_once_more_follows_the_points_that_it_is_given(finished):
    """As a benchmark does it: from the run's own points its own depth but for what neighbours' pictures changed, from
    points twice as far twice the depth."""
    run = open_run(finished[0])
    one = run.completed_submaps[0]
    one = replace(one, rows=one.rows[:2])
    maker = SparseDepthMaker(one.submap, one.camera)
    same = completed_from(run, one, maker.sparse_depth)
    twice = completed_from(run, one, lambda row: maker.sparse_depth(row).scaled(2.0))
    assert same.rows.tolist() == one.rows.tolist()
    for row in map(int, one.rows):
        depth, _, _ = same.depth(row)
        known = depth > 0
        changed = np.abs(np.log(depth[known] / one.depth(row)[0][known]))
        assert np.median(changed) < 0.01
        assert changed.max() < 0.1
        np.testing.assert_allclose(twice.depth(row)[0][known], 2 * depth[known], rtol=1e-3)
    with pytest.raises(HaustraError, match="no keyframe has 12 points"):
        completed_from(run, one, lambda row: SparseDepth(np.zeros((0, 2)), np.zeros(0), np.zeros(0)))
    with pytest.raises(HaustraError, match="closed loops"):
        completed_from(run, replace(one, depth_scale=np.ones(len(one.submap.frames))), maker.sparse_depth)


def test_error_against_the_clips_truth(finished):
    comparison = compare_run(finished[0], FOLDER)
    assert comparison.posed == comparison.total == 13
    # 0.9 mm a frame: a tenth of a step, and surface that is mostly within a millimetre.
    assert comparison.sim3.ate_rmse < 0.1
    assert comparison.simcol3d.rot_median_deg < 0.5
    assert comparison.surface.precision > 0.5
    assert comparison.surface.accuracy_median < 1.0


def test_the_default_goes_by_odometry(tmp_path, finished):
    folder = tmp_path / "auto"
    reconstruct(VIDEO, folder, tiny_config(front_end="auto"))
    record = yaml.safe_load((folder / "run.yaml").read_text())
    assert record["stages"]["structure"]["mapper"] == "odometry"
    assert [name for name in ARTEFACTS if not (folder / name).exists()] == []
    mine, colmaps = (compare_run(run, FOLDER) for run in (folder, finished[0]))
    assert mine.posed == colmaps.posed
    assert mine.sim3.ate_rmse < 0.1
    assert mine.surface.precision > 0.5


def test_the_sparse_model_is_in_output_units(finished):
    """Read by COLMAP in a process of its own; its cameras are where trajectory.tum says."""
    import subprocess

    folder, _ = finished
    code = (
        "import cv2, json, pycolmap, sys; m = pycolmap.Reconstruction(sys.argv[1]);"
        "print(json.dumps([list(i.projection_center()) for i in sorted(m.images.values(), key=lambda i: i.name)]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(folder / "sparse" / "0")], capture_output=True, text=True, check=True
    )
    trajectory = np.loadtxt(folder / "trajectory.tum")
    np.testing.assert_allclose(json.loads(done.stdout.splitlines()[-1]), trajectory[:, 1:4], atol=1e-5)


def test_the_report_is_whole_and_needs_no_network(finished):
    """What a browser makes of it is in test_page_browser.py."""
    page = (finished[0] / "report.html").read_text()
    assert page.count('class="keyframe"') == finished[1].metrics["submaps"][0]["keyframes"]
    page = re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL)  # run, but may fetch nothing: the policy
    page = re.sub(r"data:[^\"]+", "", page)  # pictures are embedded, and base64 may spell anything
    page = re.sub(r'"[A-Za-z0-9+/=]{100,}"', "", page)  # so are the scene's arrays; an address has a colon
    assert "http" not in page.replace("http-equiv", "")


@pytest.mark.parametrize("suffix", ["ply", "obj", "glb", "stl"])
def test_export_writes_every_format(finished, tmp_path, suffix, monkeypatch, capsys):
    import trimesh

    target = tmp_path / f"out.{suffix}"
    monkeypatch.setattr(sys, "argv", ["haustra", "export", str(finished[0]), str(target)])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert stop.value.code == 0
    loaded = trimesh.load(target, force="mesh", process=False)
    assert len(loaded.faces) == finished[1].metrics["submaps"][0]["faces"]


class StopAtOnce(SilentProgress):
    """Ctrl-C as soon as COLMAP reports its first step."""

    @contextmanager
    def bar(self, label, total):
        def advance(done, total=None, note=""):
            if label == "features and matches":
                raise KeyboardInterrupt

        yield advance


def test_a_second_run_that_is_stopped_four_times_ends_the_same_to_the_bit(finished, tmp_path, monkeypatch):
    """Ctrl-C in COLMAP, in completion and in its second pass after some keyframes, then in fusion; each resume keeps
    what was done."""
    calls = []
    complete = DepthCompleter.batch

    def stop_at_the_fourth(self, *arrays):
        calls.append(1)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return complete(self, *arrays)

    def stop_at_the_third(*arguments):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return photometric_points(*arguments)

    folder = tmp_path / "run"
    with pytest.raises(KeyboardInterrupt):
        reconstruct(VIDEO, folder, tiny_config(), progress=StopAtOnce())
    mine = psutil.Process().children(recursive=True)  # another run on this machine may have a worker of its own
    assert [child for child in mine if "pipeline.frontend.colmap.worker" in child.cmdline()] == []
    with monkeypatch.context() as patch:
        patch.setattr(DepthCompleter, "batch", stop_at_the_fourth)
        with pytest.raises(KeyboardInterrupt):
            reconstruct(VIDEO, folder, tiny_config(), resume=True)
    completed = {p: p.stat().st_mtime_ns for p in (folder / "first_depth").glob("*[0-9].png")}
    assert 2 <= len(completed) <= 4  # those beside the stopped one are ended; the network's first call is no keyframe
    calls.clear()
    with monkeypatch.context() as patch:
        patch.setattr(multiview_stage, "photometric_points", stop_at_the_third)
        with pytest.raises(KeyboardInterrupt):
            reconstruct(VIDEO, folder, tiny_config(), resume=True)
    assert {p: p.stat().st_mtime_ns for p in (folder / "first_depth").glob("*[0-9].png")}.items() >= completed.items()
    first = {p.name: p.stat().st_mtime_ns for p in (folder / "depth").glob("*.png")}
    assert 1 <= len(first) <= 4
    with monkeypatch.context() as patch:
        patch.setattr(surface, "fuse_submap", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            reconstruct(VIDEO, folder, tiny_config(), resume=True)
    reconstruct(VIDEO, folder, tiny_config(), resume=True)
    assert {p.name: p.stat().st_mtime_ns for p in (folder / "depth").glob("*.png")}.items() >= first.items()
    for name in ("trajectory.tum", "mesh.ply", "sparse/0/points3D.bin"):
        assert (folder / name).read_bytes() == (finished[0] / name).read_bytes(), f"{name}: of chance, or of the stops"


@pytest.mark.slow
def test_a_lost_mesh_is_made_anew(finished, tmp_path):
    (shutil.copytree(finished[0], folder := tmp_path / "copy") / "mesh.ply").write_bytes(b"\x00damage")
    reconstruct(VIDEO, folder, tiny_config(), resume=True)
    assert (folder / "mesh.ply").read_bytes() == (finished[0] / "mesh.ply").read_bytes()


@pytest.mark.parametrize("name", ["frames.json", "log/models/0/model.npz"])
def test_a_damaged_run_is_named(finished, tmp_path, name):
    folder = tmp_path / "copy"
    shutil.copytree(finished[0], folder)
    (folder / name).write_bytes(b"\x00damage")
    with pytest.raises((HaustraError, ReconstructionError), match=r"damaged|cannot be read"):
        reconstruct(VIDEO, folder, tiny_config(), resume=True)


def test_submaps_without_depth_end_empty_and_not_in_a_crash(finished, monkeypatch):
    workspace = open_workspace(finished[0])
    part = load_completed(load_frames(workspace), load_points(load_structure(workspace), workspace), workspace)[0]
    empty = replace(part, rows=part.rows[:0])
    config = tiny_config()
    settings = surface.SurfaceSettings(config.fusion, config.consistency, ScaleSource(), 0)
    surfaced = surface.fuse_submap(empty, settings, "fusion", SilentProgress())
    assert len(surfaced.mesh.faces) == 0


def test_dark_spots_are_left_open_unless_the_settings_say_otherwise(finished, monkeypatch):
    workspace = open_workspace(finished[0])
    part = load_completed(load_frames(workspace), load_points(load_structure(workspace), workspace), workspace)[0]

    def around_the_middle(mesh, voxel_size, gamma):
        return np.linalg.norm(mesh.vertices - mesh.vertices[len(mesh.vertices) // 2], axis=1) < 4 * voxel_size

    monkeypatch.setattr(surface, "dark_spots", around_the_middle)
    config = tiny_config()

    def fused(**changed):
        fusion = config.fusion.model_copy(update=changed)
        settings = surface.SurfaceSettings(fusion, config.consistency, ScaleSource(), 0)
        return surface.fuse_submap(part, settings, "fusion", SilentProgress())

    opened, closed, as_filmed = fused(), fused(open_dark_spots=False), fused(delight=False)
    assert closed.opened_share == as_filmed.opened_share == 0
    area = closed.mesh.face_areas.sum()
    assert opened.opened_share == pytest.approx(1 - opened.mesh.face_areas.sum() / area, rel=0.1)
    assert 0 < opened.opened_share < 0.1
    assert as_filmed.mesh.face_areas.sum() == pytest.approx(area)


def test_a_failing_worker_is_one_sentence(tmp_path, monkeypatch):
    with pytest.raises(HaustraError, match=r"structure failed \(exit code 1\); its log is"):
        run_isolated("pipeline.frontend.colmap.worker", "map", {}, tmp_path / "x.log", "structure", SilentProgress())
