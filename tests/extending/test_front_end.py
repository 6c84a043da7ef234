"""The front end of docs/extending.md on a rendered tube with known poses: known by its row alone."""

import sys

import cv2
import numpy as np
import pytest

from haustra.core.errors import HaustraError
from haustra.core.progress import SilentProgress
from pipeline.cli import main as cli
from pipeline.config import Config
from pipeline.finished_run import open_run
from pipeline.frontend.odometry.frame_io import frame_features
from pipeline.frontend.registry import FRONT_ENDS, check_front_end
from pipeline.frontend.structure_stage import closes_loops, front_end_of, solve_structure
from pipeline.run_folder.workspace import write_json
from tests.helpers.recipes import add_row, written
from tests.helpers.tubes.textured_tube import CAMERA, RADIUS, SIZE, camera_at, render, stored

COUNT = 14
SETTINGS = Config().front_end_settings


@pytest.fixture(scope="module")
def clip():
    poses = np.stack([camera_at(k, step=2.0) for k in range(COUNT)])
    return [render(world_from_camera) for world_from_camera in poses], poses


def true_structure(poses):
    """Points on the wall, and the pixel at which each frame sees each of them."""
    rng = np.random.default_rng(0)
    angle, height = rng.uniform(0, 2 * np.pi, 1500), rng.uniform(10, 90, 1500)
    points = np.stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), height], axis=1)
    observations, pixels = [], []
    for row, world_from_camera in enumerate(poses):
        local = (points - world_from_camera[:3, 3]) @ world_from_camera[:3, :3]
        seen = CAMERA.project(np.where(local[:, 2:] > 5, local, [0, 0, np.nan]))
        inside = np.flatnonzero(((seen > 1) & (seen < SIZE - 1)).all(axis=1) & (local[:, 2] < 60))
        observations.append(np.stack([np.full(len(inside), row), inside], axis=1))
        pixels.append(seen[inside])
    arrays = {"frames": np.arange(len(poses)), "world_from_camera": poses, "points": points}
    arrays |= {"observations": np.concatenate(observations), "pixels": np.concatenate(pixels)}
    return arrays | {"error_px": np.full(len(points), 0.1)}


@pytest.fixture
def in_folder(clip, tmp_path, monkeypatch):
    """The row is in the table, and this is a folder with slam.npz."""
    monkeypatch.chdir(tmp_path)
    np.savez("slam.npz", allow_pickle=False, **true_structure(clip[1]))
    written("pipeline/frontend/slam_file.py", monkeypatch)
    with pytest.raises(HaustraError, match="no front end 'slam'; known: auto, odometry, sfm"):
        check_front_end("slam", SETTINGS)
    assert add_row(FRONT_ENDS, "pipeline/frontend/registry.py", monkeypatch) == "slam"
    return tmp_path


def test_it_is_accepted_and_its_own_check_is_asked(in_folder):
    check_front_end("slam", SETTINGS)
    (in_folder / "slam.npz").unlink()
    with pytest.raises(HaustraError, match=r"the front end slam needs the file slam\.npz"):
        check_front_end("slam", SETTINGS)
    with pytest.raises(HaustraError, match="known: auto, odometry, sfm, poses, slam"):
        check_front_end("slma", SETTINGS)


def test_the_structure_stage_keeps_its_submap(clip, in_folder):
    (in_folder / "run").mkdir()
    workspace, frames = stored(in_folder / "run", clip[0])
    (submap,) = solve_structure(frames, frame_features(workspace), "slam", SETTINGS, workspace, SilentProgress())
    unit = workspace.result("structure")["units"][0]
    np.testing.assert_allclose(submap.world_from_camera[:, :3, 3] * unit, clip[1][:, :3, 3], atol=1e-6)
    np.testing.assert_allclose(np.hypot(*submap.points[:, :2].T) * unit, RADIUS, atol=1e-6)
    assert np.median(submap.depths()) == pytest.approx(1.0)
    record = workspace.result("structure")
    assert (front_end_of(workspace), record["mapper"], record["stats"]) == ("slam", "slam", {"left_out": 0})
    assert record["evidence"]["slam"][0]["voters"] == COUNT
    assert record["warnings"] == []
    assert not closes_loops(workspace)
    again = solve_structure(frames, frame_features(workspace), "slam", SETTINGS, workspace, SilentProgress())
    np.testing.assert_array_equal(again[0].points, submap.points)


@pytest.mark.slow
def test_the_command_goes_on_to_the_report(clip, in_folder, monkeypatch):
    """Depth, loop closing, surface and report of a run by it; the tube's radius in the path's unit is the truth's."""
    (in_folder / "images").mkdir()
    for number, image in enumerate(clip[0]):
        cv2.imwrite(str(in_folder / "images" / f"{number:04d}.png"), image[..., ::-1])
    write_json(in_folder / "camera.json", CAMERA.to_dict())
    words = ["reconstruct", "images", "-o", "out", "--front-end", "slam", "--camera", "camera.json", "-q"]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit) as stop:
        cli.reconstruct_main()
    assert not stop.value.code
    run = open_run(in_folder / "out")
    assert run.metrics["front_end"] == "slam"
    assert run.metrics["frames"]["posed"] == COUNT
    assert (run.folder / "report.html").stat().st_size > 0
    poses = run.trajectory()[1]
    scale = np.linalg.norm(clip[1][-1, :3, 3] - clip[1][0, :3, 3]) / np.linalg.norm(poses[-1, :3, 3] - poses[0, :3, 3])
    vertices = np.asarray(run.surfaces[0].mesh.vertices) * scale
    truth_from_run = clip[1][0] @ np.linalg.inv(np.vstack([poses[0][:3] * [1, 1, 1, scale], [0, 0, 0, 1]]))
    world = vertices @ truth_from_run[:3, :3].T + truth_from_run[:3, 3]
    assert abs(np.median(np.hypot(world[:, 0], world[:, 1])) - RADIUS) < 0.1 * RADIUS
