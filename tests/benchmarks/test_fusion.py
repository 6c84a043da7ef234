"""The benchmark of depths and fusion parts, on a straight tube whose depth is known in closed form."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.common.runner import run as run_benchmark
from benchmarks.fusion import comparison, depths, truncation
from benchmarks.fusion.depths import KeyframeView, completed, depth_sources, model_depth
from benchmarks.fusion.measured_run import UNMOVED, MeasuredRun
from completion.evaluation.predictors import Predictor
from haustra.core.camera import Camera
from pipeline.config import Config
from pipeline.depth.completed_submap import CompletedKeyframe
from pipeline.depth.depth_io import write_confidence, write_depth
from pipeline.depth.rectification import make_rectifier
from pipeline.depth.sparse_depth import SparseDepth
from pipeline.input.frames import write_image
from pipeline.mapping.colmap_io import write_model
from pipeline.mapping.submap import Submap
from pipeline.run_folder.workspace import Workspace, write_json
from pipeline.surface import fusion_stage
from pipeline.surface.fusion_stage import TRUNCATION_VOXELS

SIDE, COUNT, STEP = 64, 12, 0.1  # px; frames; radii that the camera moves between them
FARTHEST = 2.2  # radii
MM = 10.0  # radius of the tube, which is the run's unit
PINHOLE = Camera("PINHOLE", SIDE, SIDE, (32.0, 32.0, 32.0, 32.0))
BENT = Camera("OPENCV", SIDE, SIDE, (32.0, 32.0, 32.0, 32.0, -0.06, 0.0, 0.0, 0.0))
TRUTH_FROM_RUN = np.eye(4)
TRUTH_FROM_RUN[:3, :3] = MM * Rotation.from_euler("xyz", (20, 130, -50), degrees=True).as_matrix()
TRUTH_FROM_RUN[:3, 3] = (100, -20, 7)


def tube_depth(rays: np.ndarray) -> np.ndarray:
    """z (H,W) at which rays (H,W,2), at z = 1 from the axis along it, meet a tube of radius 1."""
    z = 1 / np.maximum(np.hypot(*np.moveaxis(rays, -1, 0)), 1e-9)
    return np.where(z < FARTHEST, z, 0).astype(np.float32)


def rays_of(camera: Camera) -> np.ndarray:
    """(H,W,2) at z = 1 of the pixels' centres."""
    pixels = np.stack(np.meshgrid(*[np.arange(SIDE) + 0.5] * 2), axis=-1).reshape(-1, 1, 2)
    lens = np.array(camera.distortion) if camera.distortion else None
    return cv2.undistortPoints(pixels, camera.matrix, lens).reshape(SIDE, SIDE, 2)


def tube_submap(camera: Camera) -> Submap:
    rng, poses = np.random.default_rng(0), np.tile(np.eye(4), (COUNT, 1, 1))
    poses[:, 2, 3] = STEP * np.arange(COUNT)
    angle, z = rng.uniform(0, 2 * np.pi, 600), rng.uniform(0.8, 2.0 + STEP * COUNT, 600)
    points = np.stack([np.cos(angle), np.sin(angle), z], axis=1)
    ahead = z - poses[:, 2, 3, None]
    observations = np.argwhere((ahead > 1.1) & (ahead < 2))
    pixels = camera.project(points[observations[:, 1]] - poses[observations[:, 0], :3, 3])
    return Submap(np.arange(COUNT), poses, points, np.full(600, 0.3), observations, pixels, camera.params)


def write_truth(folder: Path, camera: Camera) -> None:
    (folder / "depth").mkdir(parents=True)
    depth = np.round(100 * MM * tube_depth(rays_of(camera))).astype(np.uint16)
    lines = []
    for row, world_from_camera in enumerate(tube_submap(camera).world_from_camera):
        cv2.imwrite(str(folder / "depth" / f"{row:05d}.png"), depth)
        true = TRUTH_FROM_RUN @ world_from_camera
        turn = Rotation.from_matrix(true[:3, :3] / MM).as_quat()
        lines.append(" ".join(f"{value:.9f}" for value in (row / 30, *true[:3, 3], *turn)))
    (folder / "trajectory.txt").write_text("\n".join(lines) + "\n")
    write_json(folder / "camera.json", camera.to_dict() | {"depth_unit_mm": 0.01})


def write_run(root: Path, camera: Camera, submap: Submap | None = None) -> Workspace:
    """Finished, but with no surface that anyone reads: depth is the true one, with a confidence of 1."""
    workspace, submap = Workspace(root), submap or tube_submap(camera)
    for folder in (workspace.images, workspace.masks, workspace.depth, workspace.confidence):
        folder.mkdir(parents=True)
    workspace.record |= {"config": Config().model_dump(mode="json"), "source": {"sha256": {"source": "0"}}}
    verdicts = [(index, index / 30, "used") for index in range(COUNT)]
    write_json(workspace.frames, {"camera": camera.to_dict(), "frames": verdicts})
    cv2.imwrite(str(workspace.masks / "content.png"), np.full((SIDE, SIDE), 255, np.uint8))
    depth = tube_depth(rays_of(make_rectifier(camera, 120).camera))
    for index in range(COUNT):
        write_image(workspace.image_path(index), np.full((SIDE, SIDE, 3), 120, np.uint8))
        write_depth(workspace.depth_path(index), depth)
        write_confidence(workspace.confidence_path(index), np.ones((SIDE, SIDE), np.float32))
    write_model(submap, camera, workspace.models / "0")
    workspace.finish("structure", mapper="odometry", units=[1.0], warnings=[])
    workspace.finish("depth", keyframe_rows=[list(range(COUNT))], kept_share=[1.0])
    workspace.finish("surface")
    return workspace


@pytest.fixture(params=[PINHOLE, BENT], ids=["pinhole", "bent"])
def camera(request) -> Camera:
    return request.param


def source(name: str, run: MeasuredRun):
    return next(s for s in depth_sources({}, SIDE) if s.name == name)


def view_of(run: MeasuredRun) -> KeyframeView:
    return run.views[COUNT // 2]


def test_a_run_of_true_depth_measures_as_true_depth_does(tmp_path, camera):
    write_truth(tmp_path / "film", camera)
    write_run(tmp_path / "run", camera)
    run = MeasuredRun(tmp_path / "run", tmp_path / "film")
    assert run.before.mm_per_unit == pytest.approx(MM)
    assert run.about["refinement"] == "not run"
    own, true = (run.measure(source(name, run)) for name in ("the run's own", "true"))
    assert list(own) == ["plain", "consistency", "confidence", "both"]
    assert list(true) == ["plain", "consistency"]
    for columns, column in ((own, "plain"), (own, "both"), (true, "plain"), (true, "consistency")):
        assert columns[column]["precision"] > 0.99
        assert columns[column]["f_score"] > 0.9  # the far end of the tube is seen by too few frames
        assert columns[column]["left_out"] == 0
    if camera.is_pinhole:  # with a bent lens true depth comes from the nearest pixel
        for figure in ("f_score", "accuracy_mean", "completeness_mean"):
            assert own["plain"][figure] == pytest.approx(
                true["plain"][figure], abs=5e-3
            )  # depth is stored in steps of 0.004 and 0.01 mm


def test_true_depth_is_brought_to_the_rectified_picture(tmp_path):
    write_truth(tmp_path / "film", BENT)
    write_run(tmp_path / "run", BENT)
    run = MeasuredRun(tmp_path / "run", tmp_path / "film")
    depth = completed(source("true", run), view_of(run))[0]
    wanted = MM * tube_depth(rays_of(run.before.completed.camera))
    both = (depth > 0) & (wanted > 0)
    assert both.sum() > 0.9 * (wanted > 0).sum()
    raw = 0.01 * cv2.imread(str(view_of(run).true_depth), cv2.IMREAD_UNCHANGED)
    off, unrectified = ((z[both & (raw > 0)] / wanted[both & (raw > 0)] - 1).mean() for z in (depth, raw))
    assert abs(off) < 0.003  # the nearest pixel is off either way
    assert abs(unrectified) > 0.01


def test_linear_interpolation_is_exact_at_the_points_and_empty_outside_them(tmp_path):
    write_truth(tmp_path / "film", PINHOLE)
    write_run(tmp_path / "run", PINHOLE)
    view = view_of(MeasuredRun(tmp_path / "run", tmp_path / "film"))
    corner = SparseDepth(np.array([[2.5, 2.5], [2.5, 42.5], [42.5, 2.5]]), np.array([1.0, 2.0, 3.0]), np.ones(3))
    depth = depths.linear_depth(replace(view, sparse=corner))[0]
    assert depth[[2, 22, 2], [2, 2, 22]] == pytest.approx([1.0, 1.5, 2.0])
    assert not depth[40:, 40:].any()


def test_confidence_keeps_out_what_it_knows_to_be_wrong(tmp_path):
    write_truth(tmp_path / "film", PINHOLE)
    workspace = write_run(tmp_path / "run", PINHOLE)
    depth, sure = tube_depth(rays_of(PINHOLE)), np.ones((SIDE, SIDE), np.float32)
    depth[:, : SIDE // 2] *= 1.2
    sure[:, : SIDE // 2] = 0.05
    for index in range(COUNT):
        write_depth(workspace.depth_path(index), depth)
        write_confidence(workspace.confidence_path(index), sure)
    run = MeasuredRun(tmp_path / "run", tmp_path / "film")
    columns = run.measure(source("the run's own", run))
    assert columns["plain"]["precision"] < 0.8
    assert columns["confidence"]["precision"] > 0.98
    assert columns["confidence"]["recall"] < columns["plain"]["recall"] + 0.1


def test_a_contradicted_keyframe_is_left_out_by_consistency_without_any_confidence(tmp_path):
    """The stored confidence of 0 must not reach the columns that claim to use none."""
    write_truth(tmp_path / "film", PINHOLE)
    workspace = write_run(tmp_path / "run", PINHOLE)
    for index in range(COUNT):
        write_confidence(workspace.confidence_path(index), np.zeros((SIDE, SIDE), np.float32))
    write_depth(workspace.depth_path(7), 0.6 * tube_depth(rays_of(PINHOLE)))
    run = MeasuredRun(tmp_path / "run", tmp_path / "film")
    columns = run.measure(source("the run's own", run))
    assert columns["plain"]["left_out"] == 0
    assert columns["consistency"]["left_out"] == 1
    assert columns["consistency"]["f_score"] > 0.9
    assert columns["both"]["f_score"] == 0
    assert columns["both"]["accuracy_mean"] is None


def test_a_moved_map_is_also_fused_as_it_was_before(tmp_path):
    """The second half of the film in a unit 1.2 times too large, and put right by the refinement stage."""
    write_truth(tmp_path / "film", PINHOLE)
    true, scales = tube_submap(PINHOLE), np.where(np.arange(COUNT) < COUNT // 2, 1.0, 1.2)
    poses = true.world_from_camera.copy()
    poses[1:, 2, 3] = np.cumsum(np.diff(true.world_from_camera[:, 2, 3]) * scales[1:])
    workspace = write_run(tmp_path / "run", PINHOLE, replace(true, world_from_camera=poses))
    for index, scale in enumerate(scales):
        write_depth(workspace.depth_path(index), scale * tube_depth(rays_of(PINHOLE)))
    folder = workspace.log / "refined" / "0"
    write_model(true, PINHOLE, folder)
    np.savez(folder / "depth_scale.npz", rows=np.arange(COUNT), depth_scale=1 / scales)
    workspace.finish("refinement", submaps=[{"members": [0], "moved": True}], warnings=[])
    run = MeasuredRun(tmp_path / "run", tmp_path / "film")
    columns = run.measure(source("the run's own", run))
    assert run.about["refinement"] == "moved"
    assert columns["both"]["f_score"] > 0.9
    assert columns[UNMOVED]["f_score"] < 0.85
    change = comparison.changes({"own": columns})["pose graph, on top of all"]["own"]
    assert change == pytest.approx(100 * (columns["both"]["f_score"] - columns[UNMOVED]["f_score"]))


def test_a_metric_network_is_given_millimetres_and_its_answer_is_divided_again(monkeypatch):
    seen = {}

    def predict(rgb, sparse, lens):
        seen.update(rgb=rgb, sparse=sparse, lens=lens)
        return np.full(sparse.shape, 30.0, np.float32), None

    monkeypatch.setattr(depths, "load_predictor", lambda model: Predictor(predict))
    ones = np.ones((SIDE, SIDE), np.float32)
    keyframe = CompletedKeyframe(0, np.zeros((SIDE, SIDE, 3), np.uint8), ones, ones, np.eye(4))
    sparse = SparseDepth(np.array([[10.5, 21.0], [63.9, 63.9]]), np.array([2.0, 1.5]), np.full(2, 0.01))
    view = KeyframeView(keyframe, sparse, make_rectifier(PINHOLE, 120), MM, None, 0.01)
    depth, confidence = model_depth("paper.safetensors", SIDE // 2)(view)
    assert confidence is None
    np.testing.assert_allclose(depth, 3.0)
    assert depth.shape == (SIDE, SIDE)
    assert seen["rgb"].shape == (SIDE // 2, SIDE // 2, 3)
    assert {(r, c): seen["sparse"][r, c] for r, c in np.argwhere(seen["sparse"])} == {(10, 5): 20.0, (31, 31): 15.0}
    np.testing.assert_allclose(seen["lens"], 16.0)


def figures(f: float) -> dict:
    return {"f_score": f, "accuracy_mean": 0.5, "completeness_mean": 0.25}


def test_summary_is_what_a_hand_computes():
    own = [(0.50, 0.52, 0.60, 0.57), (0.40, 0.41, 0.39, 0.42), (0.70, 0.69, 0.71, 0.75)]
    names = ("plain", "consistency", "confidence", "both")
    runs = {
        str(k): {"own": dict(zip(names, map(figures, f), strict=True)), "linear": {"plain": figures(0.3)}}
        for k, f in enumerate(own)
    }
    runs["2"]["own"][UNMOVED] = figures(0.65)
    summary = comparison.summarised(runs)
    alone = summary["consistency, alone"]
    assert list(alone) == ["own"]  # linear has no second column
    assert alone["own"]["median"] == pytest.approx(1.0)
    assert [alone["own"][key] for key in ("helps", "hurts", "runs")] == [2, 1, 3]
    assert (alone["own"]["min"], alone["own"]["max"]) == (pytest.approx(-1.0), pytest.approx(2.0))
    on_top = summary["consistency, on top of confidence"]["own"]
    assert (on_top["median"], on_top["helps"]) == (pytest.approx(3.0), 2)
    assert summary["confidence, on top of consistency"]["own"]["median"] == pytest.approx(5.0)
    assert summary["consistency and confidence"]["own"]["median"] == pytest.approx(5.0)
    graph = summary["pose graph, on top of all"]["own"]
    assert (graph["median"], graph["runs"]) == (pytest.approx(10.0), 1)


def test_the_command_prints_both_tables_and_writes_json(tmp_path, capsys):
    write_truth(tmp_path / "film", PINHOLE)
    for name in ("first", "second"):
        write_run(tmp_path / name, PINHOLE)
    pairs = [f"{tmp_path / name}={tmp_path / 'film'}" for name in ("first", "second")]
    run_benchmark(comparison, "benchmarks.fusion comparison", [*pairs, "--json", str(tmp_path / "out.json")])
    printed = capsys.readouterr().out
    record = json.loads((tmp_path / "out.json").read_text())
    assert list(record["runs"]) == ["first", "second"]
    assert record["runs"]["first"] == record["runs"]["second"]
    rows = [line for line in printed.splitlines() if "| linear |" in line and "not run" in line]
    f_score = 100 * record["runs"]["first"]["linear"]["plain"]["f_score"]
    assert len(rows) == 2
    assert rows[0].startswith(f"| first ({COUNT} of {COUNT} frames) | linear | {f_score:.1f} / ")
    assert "not measured: no run has both" in printed


def test_truncations_are_measured_side_by_side_and_kept(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(truncation, "TRUNCATIONS", (12.0, TRUNCATION_VOXELS))
    write_truth(tmp_path / "film", PINHOLE)
    write_run(tmp_path / "run", PINHOLE)
    record = tmp_path / "out.json"
    pair = f"{tmp_path / 'run'}={tmp_path / 'film'}"
    asked = [pair, "--role", "chosen", "--json", str(record)]
    run_benchmark(truncation, "benchmarks.fusion truncation", asked)
    run = json.loads(record.read_text())["runs"][0]
    assert (run["sequence"], run["method"]) == ("film", "chosen")
    whole = MeasuredRun(tmp_path / "run", tmp_path / "film")
    own, scores = depth_sources({}, 160)[1], run["truncations"]
    assert scores[f"{TRUNCATION_VOXELS:g}"]["f_score"] == pytest.approx(100 * whole.measure(own)["both"]["f_score"])
    monkeypatch.setattr(fusion_stage, "TRUNCATION_VOXELS", 12.0)  # as if runs had it
    assert scores["12"]["f_score"] == pytest.approx(100 * whole.measure(own)["both"]["f_score"])
    assert scores["12"] != scores[f"{TRUNCATION_VOXELS:g}"]
    capsys.readouterr()
    run_benchmark(truncation, "benchmarks.fusion truncation", asked)  # of a film that the record has, nothing anew
    assert capsys.readouterr().out.startswith("12 voxels: mean ")
