"""CLiMB's reference is every true pose, and what is judged is what the submission holds, whatever frames a run saw."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from evo.core import metrics
from evo.core.trajectory import PoseTrajectory3D
from scipy.spatial.transform import Rotation, Slerp

from haustra.core.errors import HaustraError
from pipeline import climb
from pipeline.climb import compare_climb, write_submission
from pipeline.compare import true_path
from pipeline.config import Config, FrameSettings
from reconstruction.evaluation.climb import ClimbErrors
from reconstruction.evaluation.trajectory_io import write_tum

FRAMES, FPS = 80, 30
MakeRun = Callable[..., None]


def true_poses() -> np.ndarray:
    """A winding path (80,4,4), mm, of a camera that looks about."""
    t = np.arange(FRAMES) / FPS
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    poses[:, :3, 3] = np.stack([9 * np.sin(2.1 * t), 6 * np.cos(1.7 * t), 20 * t + np.sin(5 * t)], axis=1)
    turns = np.stack([0.4 * np.sin(1.3 * t), 0.3 * t, 0.2 * np.cos(2 * t)], axis=1)
    poses[:, :3, :3] = Rotation.from_rotvec(turns).as_matrix()
    return poses


def write_images(path: Path, numbers: np.ndarray, poses: np.ndarray) -> None:
    """A COLMAP images.txt, camera_from_world, of pictures with these numbers."""
    lines = []
    for number, pose in zip(numbers.tolist(), np.linalg.inv(poses), strict=True):
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        place = " ".join(repr(float(value)) for value in (w, x, y, z, *pose[:3, 3]))
        lines.append(f"{number + 1} {place} 1 frame_{number:06d}.png\n\n")
    path.write_text("".join(lines))


@pytest.fixture
def make_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> MakeRun:
    """A run that looked at some frames and posed them exactly, in its own world and in mm."""

    def make(looked_at: np.ndarray, settings: FrameSettings | None = None) -> None:
        (tmp_path / "frames.json").write_text(
            json.dumps({"frames": [[k, k / FPS, "used"] for k in looked_at.tolist()]})
        )
        poses = np.linalg.inv(true_poses()[7]) @ true_poses()[looked_at]
        opened = SimpleNamespace(
            workspace=SimpleNamespace(
                frames=tmp_path / "frames.json",
                record={"source": {"path": "film.mp4"}},
                config=Config(frames=settings or FrameSettings()),
                result=lambda _: {"stats": {"frames_per_second": 60.0}},
            ),
            frames=SimpleNamespace(index=looked_at),
            submaps=[SimpleNamespace(frames=looked_at, points=np.zeros((1, 3)))],
            surfaces=[SimpleNamespace(scale=SimpleNamespace(factor=1.0, unit="mm"))],
            trajectory=lambda _: (looked_at / FPS, poses),
        )
        monkeypatch.setattr(climb, "open_run", lambda _: opened)

    return make


def judged(folder: Path, min_common: int = 20) -> list[ClimbErrors]:
    """Against one truth in two forms: all frames by time, and by the numbers of pictures."""
    write_tum(folder / "truth.tum", np.arange(FRAMES) / FPS, true_poses())
    write_images(folder / "images.txt", np.arange(FRAMES) + 1, true_poses())
    return [compare_climb(folder, folder / name, min_common) for name in ("truth.tum", "images.txt")]


def test_two_forms_of_one_truth_give_one_verdict_of_a_run_with_a_stride(make_run: MakeRun, tmp_path: Path) -> None:
    """All but the last frame are posed, or lie between two that are."""
    make_run(np.arange(0, FRAMES, 2))
    by_time, by_number = judged(tmp_path)
    for found in (by_time, by_number):
        assert (found.matched, found.interpolated, found.reference, found.failed) == (79, 39, 80, False)
        assert found.notes == ()
    assert by_time.ate_mean_mm == pytest.approx(by_number.ate_mean_mm, rel=1e-6)


def test_a_film_that_was_cut_beforehand_costs_the_frames_that_it_lacks(make_run: MakeRun, tmp_path: Path) -> None:
    make_run(np.arange(60))
    for found in judged(tmp_path):
        assert (found.matched, found.reference, found.tracked_fraction) == (60, 80, 0.75)


@pytest.mark.parametrize("stride", [1, 3])
def test_only_a_part_that_was_asked_for_cuts_the_reference_and_it_is_said(
    make_run: MakeRun, tmp_path: Path, stride: int
) -> None:
    """From frame 15 to before frame 60: 45 frames."""
    looked_at = np.array([k for k in range(15, 60) if k % stride == 0])
    make_run(looked_at, FrameSettings(start_s=0.5, end_s=2.0, stride=stride))
    for found in judged(tmp_path):
        assert (found.reference, found.matched) == (45, looked_at[-1] - looked_at[0] + 1)
        assert "reference   cut to the part that the run was asked for (--start, --end): 45 of 80" in str(found)


def test_poses_of_skipped_frames_are_written_and_compare_judges_those_that_are_written(
    make_run: MakeRun, tmp_path: Path
) -> None:
    """Frames 0 to 78 in order, the odd ones by SciPy's Slerp; the ATE of what is written, by evo."""
    looked_at = np.arange(0, FRAMES, 2)
    make_run(looked_at)
    folder = write_submission(tmp_path, tmp_path / "out")
    text = (folder / "camera_trajectory" / "cam_traj_map_000.txt").read_text().splitlines()
    rows = [line.split(",") for line in text if not line.startswith("#")]
    frames = np.array([int(row[1].removesuffix(".png")) for row in rows]) - 1
    assert frames.tolist() == list(range(79))
    assert [row[9] for row in rows] == ["01"[frame % 2] for frame in frames]
    table = np.array([[row[0], *row[2:9]] for row in rows], float)
    np.testing.assert_allclose(table[:, 0], frames / FPS, atol=1e-6)
    posed = np.linalg.inv(true_poses()[7]) @ true_poses()[looked_at]
    centres = np.stack([np.interp(frames, looked_at, posed[:, axis, 3]) for axis in range(3)], axis=1)
    np.testing.assert_allclose(table[:, 1:4], centres, atol=1e-8)
    turns = Slerp(looked_at, Rotation.from_matrix(posed[:, :3, :3]))(frames)
    written = Rotation.from_quat(table[:, [5, 6, 7, 4]])
    assert (turns.inv() * written).magnitude().max() < 1e-6
    estimated = PoseTrajectory3D(table[:, 1:4], table[:, 4:8], frames.astype(float))
    true = PoseTrajectory3D(poses_se3=list(true_poses()[frames]), timestamps=frames.astype(float))
    estimated.align(true, correct_scale=True)
    absolute = metrics.APE(metrics.PoseRelation.translation_part)
    absolute.process_data((true, estimated))
    for found in judged(tmp_path):
        assert found.ate_mean_mm == pytest.approx(absolute.error.mean(), rel=1e-5)


def test_of_several_true_poses_of_one_frame_the_nearest_in_time_counts(make_run: MakeRun, tmp_path: Path) -> None:
    """A tracker of three times the film's rate."""
    make_run(np.arange(FRAMES))
    fine = np.arange(3 * FRAMES - 2) / 3
    poses = np.tile(np.eye(4), (len(fine), 1, 1))
    for axis in range(3):
        poses[:, axis, 3] = np.interp(fine, np.arange(FRAMES), true_poses()[:, axis, 3])
    write_tum(tmp_path / "tracker.tum", fine / FPS, poses)
    found = compare_climb(tmp_path, tmp_path / "tracker.tum", 20)
    assert (found.matched, found.reference) == (80, 80)
    assert found.ate_mean_mm < 1e-5


def test_a_part_without_true_poses_is_one_sentence(make_run: MakeRun, tmp_path: Path) -> None:
    make_run(np.arange(60, 80), FrameSettings(start_s=2.0))
    write_images(tmp_path / "images.txt", np.arange(1, 31), true_poses()[:30])
    with pytest.raises(HaustraError, match="has 0 poses in the part that the run is of"):
        compare_climb(tmp_path, tmp_path / "images.txt")


def in_metres(poses: np.ndarray) -> np.ndarray:
    scaled = poses.copy()
    scaled[:, :3, 3] /= 1000
    return scaled


@pytest.mark.parametrize(
    ("stored", "hint"),
    [
        (in_metres, "say metres: multiply the truth by 1000"),
        (lambda poses: np.roll(poses, 6, axis=0), "better with the true times -0.2 s"),
        (lambda poses: poses @ np.diag([1.0, -1, -1, 1]), "OpenGL's axes"),
        (np.linalg.inv, "camera_from_world, and world_from_camera is read"),
        (lambda poses: np.random.default_rng(0).permutation(poses), "the truth of another film"),
        (lambda poses: poses, ""),
    ],
)
def test_a_wrong_truth_is_named_by_this_protocol_too(make_run: MakeRun, tmp_path: Path, stored, hint: str) -> None:
    make_run(np.arange(FRAMES))
    truth = stored(true_poses())
    write_tum(tmp_path / "truth.tum", np.arange(FRAMES) / FPS, truth)
    write_images(tmp_path / "images.txt", np.arange(FRAMES) + 1, truth)
    for reference in ("truth.tum", "images.txt"):
        found = compare_climb(tmp_path, tmp_path / reference, 20)
        assert hint in " ".join(found.hints)
        assert bool(found.hints) == bool(hint)
        assert ("CAUTION     " in str(found)) == bool(hint)


def test_pictures_that_are_counted_from_0_are_named(make_run: MakeRun, tmp_path: Path) -> None:
    make_run(np.arange(FRAMES))
    write_images(tmp_path / "images.txt", np.arange(FRAMES), true_poses())
    assert "CAUTION     the pictures are numbered from 0" in str(compare_climb(tmp_path, tmp_path / "images.txt", 20))


def test_a_wrong_truth_is_named_where_nothing_counts(make_run: MakeRun, tmp_path: Path) -> None:
    make_run(np.arange(FRAMES))
    write_tum(tmp_path / "truth.tum", np.arange(FRAMES) / FPS, in_metres(true_poses()))
    said = str(compare_climb(tmp_path, tmp_path / "truth.tum", 100))
    assert "has enough poses" in said
    assert "metres" in said


@pytest.mark.parametrize("name", ["images0.txt", "model.txt", "poses"])
@pytest.mark.parametrize("comment", ["", "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"])
def test_a_colmap_model_is_known_by_what_it_holds(make_run: MakeRun, tmp_path: Path, name: str, comment: str) -> None:
    """The protocol that needs times says that it is one, and which protocol takes it."""
    make_run(np.arange(FRAMES))
    write_images(tmp_path / "images.txt", np.arange(FRAMES) + 1, true_poses())
    (tmp_path / name).write_text(comment + (tmp_path / "images.txt").read_text())
    assert compare_climb(tmp_path, tmp_path / name, 20).matched == 80
    for model in (name, "images.txt", "."):
        with pytest.raises(
            HaustraError, match="of a COLMAP model, which have no times: compare it with --protocol climb"
        ):
            true_path(tmp_path / model, None)


def test_a_folder_with_its_own_path_is_no_colmap_model(tmp_path: Path) -> None:
    write_images(tmp_path / "images.txt", np.arange(FRAMES) + 1, true_poses())
    write_tum(tmp_path / "trajectory.txt", np.arange(FRAMES, dtype=float), true_poses())
    assert len(true_path(tmp_path, None)[0]) == FRAMES


def test_a_data_sets_folder_with_a_model_beside_its_truth_is_no_colmap_model(tmp_path: Path) -> None:
    """As where COLMAP was run in a folder of C3VD, whose pose.txt is the truth."""
    write_images(tmp_path / "images.txt", np.arange(FRAMES), np.tile(np.eye(4), (FRAMES, 1, 1)))
    stored = np.swapaxes(true_poses(), 1, 2).reshape(FRAMES, 16)
    (tmp_path / "pose.txt").write_text("\n".join(",".join(map(repr, row)) for row in stored.tolist()))
    run = SimpleNamespace(frames=SimpleNamespace(seconds_of_numbers=lambda numbers: numbers / FPS))
    np.testing.assert_allclose(true_path(tmp_path, run)[1], true_poses())


def test_a_tum_file_is_no_colmap_model(tmp_path: Path) -> None:
    write_tum(tmp_path / "truth.txt", np.arange(FRAMES, dtype=float), true_poses())
    assert len(true_path(tmp_path / "truth.txt", None)[0]) == FRAMES
