"""A run as a CLiMB submission, read back by its documented layout, and compared with references of each kind."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haustra.core.errors import HaustraError
from pipeline import climb
from pipeline.climb import compare_climb, read_numbered_images, write_submission
from pipeline.config import Config
from reconstruction.evaluation.trajectory_io import write_tum
from tests.helpers.tiny_run import TinyRun, make_tiny_run


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> TinyRun:
    """Two submaps; the front end's loop took 1/20 s a frame of this film of 30 frames a second."""
    tiny = make_tiny_run(tmp_path / "run")

    def trajectory(number: int) -> tuple[np.ndarray, np.ndarray]:
        submap, factor = tiny.completed[number].submap, tiny.surfaces[number].scale.factor
        poses = submap.world_from_camera.copy()
        poses[:, :3, 3] *= factor
        return submap.frames / 30, poses

    opened = SimpleNamespace(
        workspace=SimpleNamespace(
            frames=tiny.workspace.frames,
            record=tiny.workspace.record,
            config=Config(),
            result=lambda _: {"stats": {"frames_per_second": 20.0}},
        ),
        frames=tiny.frames,
        submaps=[one.submap for one in tiny.completed],
        surfaces=tiny.surfaces,
        trajectory=trajectory,
    )
    monkeypatch.setattr(climb, "open_run", lambda _: opened)
    return tiny


def rows_of(path: Path) -> list[list[str]]:
    return [line.split(",") for line in path.read_text().splitlines() if not line.startswith("#")]


def test_the_tree_has_each_submap_with_frames_from_one_and_skipped_ones_marked(run: TinyRun, tmp_path: Path) -> None:
    folder = write_submission(tmp_path / "run", tmp_path / "out")
    for number, completed in enumerate(run.completed):
        submap, factor = completed.submap, run.surfaces[number].scale.factor
        rows = rows_of(folder / "camera_trajectory" / f"cam_traj_map_{number:03d}.txt")
        ids = np.array([int(row[1].removesuffix(".png")) for row in rows])
        marked = np.array([row[9] == "1" for row in rows])
        assert (np.diff(ids) > 0).all()
        np.testing.assert_array_equal(ids[~marked] - 1, submap.frames)
        skipped = sorted(set(range(submap.frames[0], submap.frames[-1])) - set(submap.frames.tolist()))
        assert (ids[marked] - 1).tolist() == skipped
        assert skipped or number == 1
        table = np.array([row[2:9] for row in rows], float)
        np.testing.assert_allclose(table[~marked, :3], submap.centres * factor, atol=1e-8)
        w, x, y, z = table[~marked, 3:].T
        turned = Rotation.from_quat(np.stack([x, y, z, w], axis=1)).as_matrix()
        np.testing.assert_allclose(turned, submap.world_from_camera[:, :3, :3], atol=1e-8)
        for place in np.flatnonzero(marked):  # between its neighbours
            assert (table[place, 2] - table[place - 1, 2]) * (table[place + 1, 2] - table[place, 2]) > 0
        points = [line.split() for line in (folder / "3D_maps" / f"{number:03d}" / "points3D.txt").open()]
        assert len([line for line in points if line[0] != "#"]) == len(submap.points)
    told = dict(line.split("=") for line in (folder / "runtime.txt").read_text().split())
    assert float(told["processing_seconds"]) == pytest.approx(len(run.frames.index) / 20)
    (folder / "camera_trajectory" / "cam_traj_map_007.txt").write_text("of an earlier run")
    (folder / "3D_maps" / "007").mkdir()
    write_submission(tmp_path / "run", tmp_path / "out")
    assert len(list((folder / "camera_trajectory").iterdir())) == len(list((folder / "3D_maps").iterdir())) == 2


def test_a_folder_with_something_else_is_refused(run: TinyRun, tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").write_text("")
    with pytest.raises(HaustraError, match="holds something else"):
        write_submission(tmp_path / "run", tmp_path / "full")


def test_the_reference_may_be_a_tum_file_or_a_colmap_model_of_numbered_pictures(run: TinyRun, tmp_path: Path) -> None:
    submap = run.completed[0].submap
    other = np.eye(4)
    other[:3, :3] = Rotation.from_euler("xyz", [0.3, 1, -2]).as_matrix()
    truth = submap.world_from_camera.copy()
    truth[:, :3, 3] *= 40.0
    truth = other @ truth
    write_tum(tmp_path / "truth.tum", submap.frames / 30, truth)
    lines = []
    for number, (frame, world_from_camera) in enumerate(zip(submap.frames, truth, strict=True)):
        camera_from_world = np.linalg.inv(world_from_camera)
        x, y, z, w = Rotation.from_matrix(camera_from_world[:3, :3]).as_quat()
        place = " ".join(map(repr, map(float, (w, x, y, z, *camera_from_world[:3, 3]))))
        lines += [f"{number + 1} {place} 1 {frame + 1:06d}.png", "1.0 2.0 -1"]
    (tmp_path / "images.txt").write_text("# comment\n" + "\n".join(lines) + "\n")
    for reference in ("truth.tum", "images.txt", "."):  # the last one: the model's folder
        found = compare_climb(tmp_path / "run", tmp_path / reference, 20)
        assert found.ate_mean_mm == pytest.approx(0, abs=1e-4)
        assert (found.matched, found.reference, found.submaps, found.submaps_left_out) == (90, 90, 1, 1)
        pace = 0.05 * len(run.frames.index) / (len(run.frames.index) + 7)  # seven were left out before the loop
        assert found.seconds_per_frame == pytest.approx(pace)
        assert found.time_factor == pytest.approx(1 + 0.5 * (30 * pace - 1))


def test_a_picture_s_number_is_the_last_in_its_name(tmp_path: Path) -> None:
    lines = [f"{k} 1 0 0 0 {k} 0 0 1 HCULB_00364/frame_{k:06d}.jp2\n" for k in (12, 13)]
    (tmp_path / "images.txt").write_text("\n".join(lines) + "\n")
    assert read_numbered_images(tmp_path / "images.txt")[0].tolist() == [12, 13]


@pytest.mark.parametrize("text", ["", "1 2 3\n\n", "1 1 0 0 0 0 0 0 1 picture.png\n\n"])
def test_what_is_no_numbered_images_txt_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "images.txt").write_text(text)
    with pytest.raises(HaustraError, match=r"images\.txt"):
        read_numbered_images(tmp_path / "images.txt")


def test_a_reference_of_another_clock_is_refused_as_everywhere(run: TinyRun, tmp_path: Path) -> None:
    submap = run.completed[0].submap
    write_tum(tmp_path / "late.tum", submap.frames / 30 + 3.5, submap.world_from_camera)
    with pytest.raises(HaustraError, match="are of one time"):
        compare_climb(tmp_path / "run", tmp_path / "late.tum", 20)


def test_without_the_time_of_the_frame_loop_nothing_is_written(
    run: TinyRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(climb, "loop_seconds", lambda _: None)
    with pytest.raises(HaustraError, match="frame loop"):
        write_submission(tmp_path / "run", tmp_path / "out")
    assert not (tmp_path / "out").exists()
