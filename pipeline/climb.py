"""A run in CLiMB: its submission tree, and its errors against a reference by that benchmark's protocol.

The tree is 3D_maps/NNN/points3D.txt, camera_trajectory/cam_traj_map_NNN.txt and runtime.txt, as the benchmark's
submission instructions have it. Frames are numbered from 1.
"""

import re
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from haustra.core.errors import HaustraError
from haustra.core.se3 import interpolated
from haustra.core.text import counted
from pipeline.compare import is_colmap_model, true_path
from pipeline.finished_run import Run, open_run
from pipeline.input.pose_files.colmap_poses import read_colmap_poses
from pipeline.input.pose_files.pairing import paired
from pipeline.input.pose_files.pose_table import FilmFrames
from pipeline.truth.film_part import asked_seconds
from pipeline.truth.hints import Timed, path_hints
from reconstruction.evaluation.climb import MIN_COMMON, ClimbErrors, climb_errors
from reconstruction.evaluation.trajectory_metrics import trajectory_errors

Array = NDArray[np.float64]
ROUNDED = 1e-6  # frames, by which times between two may be off
HEADER = "# timestamp, name_image, tx, ty, tz, qw, qx, qy, qz, interpolated\n"


@dataclass(frozen=True)
class SubmittedPath:
    """One submap's poses as a submission holds them: frames of the film from 0 (N,), ascending, their seconds (N,),
    world_from_camera (N,4,4) in the output unit, and which are interpolated (N,)."""

    frames: NDArray[np.int64]
    seconds: Array
    world_from_camera: Array
    interpolated: NDArray[np.bool_]


@dataclass(frozen=True)
class Reference:
    """True poses: frames of the film from 0 (N,), ascending, and world_from_camera (N,4,4), mm. counted_from: number of
    the first picture, where the frames are known by pictures' numbers; CLiMB's is 1."""

    frames: NDArray[np.int64]
    world_from_camera: Array
    counted_from: int = 1

    def rows(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> "Reference":
        return replace(self, frames=self.frames[which], world_from_camera=self.world_from_camera[which])


def compare_climb(run: Path, reference: Path, min_common: int = MIN_COMMON) -> ClimbErrors:
    """Errors of a finished run against a path: an RGB-D folder, a TUM file, or a COLMAP model in mm (its folder, or its
    images.txt or images.bin), whose pictures are numbered from 1.

    Judged are the poses that `write_submission` writes, interpolated ones with them, as the benchmark's evaluator
    judges every line. The reference is every pose of the path: frames that the run did not look at cost it. Only a part
    that was asked for (--start, --end) cuts the reference, and `notes` say so.
    """
    finished = open_run(run)
    film = FilmFrames.of(finished.workspace)
    whole = read_reference(reference, finished, film)
    asked_s, slack = asked_seconds(finished.workspace), 0.01 * film.interval  # of times that are rounded
    seconds = film.seconds_of(whole.frames)
    truth = whole.rows((seconds >= asked_s[0] - slack) & (seconds < asked_s[1] - slack))
    if len(truth.frames) < min(2, len(whole.frames)):
        raise HaustraError(f"{reference} has {counted(len(truth.frames), 'pose')} in the part that the run is of")
    notes = () if len(truth.frames) == len(whole.frames) else (_cut_note(truth, whole),)
    paths = submitted_paths(finished, film)
    loop = loop_seconds(finished)
    errors = climb_errors(
        [(path.frames, path.world_from_camera) for path in paths],
        (truth.frames, truth.world_from_camera),
        1 / float(np.median(np.diff(film.seconds))),
        None if loop is None else loop / len(film.index),
        min_common,
        [path.interpolated for path in paths],
    )
    return replace(errors, notes=notes, hints=_hints(finished, film, whole))


def read_reference(path: Path, run: Run, film: FilmFrames) -> Reference:
    """The true poses by the film's frames. Each pose of a path with times belongs to the frame that is nearest in time,
    and of several poses of one frame the nearest is taken. HaustraError where the path is of another time."""
    if is_colmap_model(path):
        numbers, world_from_camera = read_numbered_images(path)
        order = np.argsort(numbers, kind="stable")
        return Reference(numbers[order] - 1, world_from_camera[order], 0 if numbers.min() == 0 else 1)
    seconds, world_from_camera = true_path(path, run)
    paired(film.seconds, seconds, path)
    exact = film.numbers_at(seconds)
    frames = np.floor(exact + 0.5 + ROUNDED).astype(np.int64)  # halves all one way: to even, two would be one frame
    order = np.lexsort((np.abs(exact - frames), frames))
    return Reference(frames, world_from_camera).rows(order[np.unique(frames[order], return_index=True)[1]])


def submitted_paths(run: Run, film: FilmFrames) -> list[SubmittedPath]:
    """Each submap's poses, and between its first and its last one those of all frames of the film that no submap
    poses, looked at or not: centres on the straight line, rotations on the great arc between the posed neighbours."""
    taken = np.unique(np.concatenate([submap.frames for submap in run.submaps]))
    paths = []
    for number, submap in enumerate(run.submaps):
        posed, world_from_camera = submap.frames, run.trajectory(number)[1]
        between = np.setdiff1d(np.arange(posed[0], posed[-1]), taken)
        frames = np.union1d(posed, between)
        seconds = film.seconds_of(frames)
        poses = np.asarray(interpolated(film.seconds_of(posed), world_from_camera, seconds), np.float64)
        made = np.isin(frames, between)
        poses[~made] = world_from_camera  # as they are, not through a rotation vector and back
        paths.append(SubmittedPath(frames, seconds, poses, made))
    return paths


def write_submission(run: Path, folder: Path) -> Path:
    """Write one run folder of a submission. Raises `HaustraError` where the folder holds something else, or the run
    does not say how long its frame loop took. A run does not record the time before that loop, which the benchmark does
    not score: init_seconds is 0. An earlier submission in the folder is replaced."""
    finished = open_run(run)
    loop = loop_seconds(finished)
    if loop is None:
        raise HaustraError(f"{run} does not say how long its frame loop took, which runtime.txt needs; use odometry")
    if folder.exists() and not folder.is_dir():
        raise HaustraError(f"{folder} is a file; give a new or empty folder")
    if folder.exists() and any(folder.iterdir()) and not (folder / "runtime.txt").exists():
        raise HaustraError(f"{folder} holds something else; give another folder")
    paths, maps = folder / "camera_trajectory", folder / "3D_maps"
    for part in (paths, maps):
        shutil.rmtree(part, ignore_errors=True)  # an earlier run's submaps would be read as this one's
        part.mkdir(parents=True)
    submitted = submitted_paths(finished, FilmFrames.of(finished.workspace))
    for number, (submap, path) in enumerate(zip(finished.submaps, submitted, strict=True)):
        (paths / f"cam_traj_map_{number:03d}.txt").write_text(HEADER + "".join(_lines(path)))
        target = maps / f"{number:03d}"
        target.mkdir()
        points = submap.points * finished.surfaces[number].scale.factor
        rows = (f"{k} {x:.6f} {y:.6f} {z:.6f} 128 128 128 0\n" for k, (x, y, z) in enumerate(points, start=1))
        (target / "points3D.txt").write_text("# POINT3D_ID, X, Y, Z, R, G, B, ERROR\n" + "".join(rows))
    runtime = f"init_seconds=0\nprocessing_seconds={loop:.6f}\n"
    (folder / "runtime.txt").write_text(runtime)
    return folder


def read_numbered_images(path: Path) -> tuple[NDArray[np.int64], Array]:
    """Last numbers (N,) in the pictures' names and world_from_camera (N,4,4) of the images of a COLMAP model."""
    table = read_colmap_poses(path)
    numbers = [re.findall(r"\d+", Path(name).stem) for name in (table.names if table else None) or ()]
    if table is None or not all(numbers):
        raise HaustraError(f"{path}: no images of a COLMAP model with numbered pictures")
    return np.array([int(found[-1]) for found in numbers]), table.world_from_camera


def loop_seconds(run: Run) -> float | None:
    """Wall time of tracking and local mapping; None of a front end without a frame loop. Frames that were left out
    before, such as blurred ones, were not in it."""
    pace = run.workspace.result("structure").get("stats", {}).get("frames_per_second")
    return len(run.frames.index) / float(pace) if pace else None


def _hints(run: Run, film: FilmFrames, truth: Reference) -> tuple[str, ...]:
    """Sentences that would explain a bad fit of the largest submap, by the frames that it poses; none where fewer than
    three have a true pose, or the path does not move."""
    zero = "the pictures are numbered from 0, and CLiMB's from 1: each true pose is taken for that of the frame before"
    counted_from_0 = () if truth.counted_from else (zero,)
    frames, world_from_camera = run.submaps[0].frames, run.trajectory(0)[1]
    _, mine, theirs = np.intersect1d(frames, truth.frames, return_indices=True)
    estimated, true = world_from_camera[mine], truth.world_from_camera[theirs]
    try:
        scale = trajectory_errors(estimated, true, "sim3", "mm").scale
    except HaustraError:
        return counted_from_0
    path = Timed(film.seconds_of(frames), world_from_camera[:, :3, 3])
    true_path_of_run = Timed(film.seconds_of(truth.frames), truth.world_from_camera[:, :3, 3])
    in_mm = run.surfaces[0].scale.unit == "mm"
    return counted_from_0 + path_hints(path, true_path_of_run, estimated, true, scale, in_mm)


def _cut_note(kept: Reference, whole: Reference) -> str:
    return (
        f"cut to the part that the run was asked for (--start, --end): {len(kept.frames)} of {len(whole.frames)} "
        "of its frames"
    )


def _lines(path: SubmittedPath) -> list[str]:
    """A submap's lines in the order of its frames."""
    turns, lines = Rotation.from_matrix(path.world_from_camera[:, :3, :3]).as_quat(), []
    for frame, time, pose, (x, y, z, w), mark in zip(
        path.frames.tolist(), path.seconds.tolist(), path.world_from_camera, turns, path.interpolated, strict=True
    ):
        place = ",".join(f"{value:.9f}" for value in (*pose[:3, 3], w, x, y, z))
        lines.append(f"{time:.6f},{frame + 1:06d}.png,{place},{int(mark)}\n")
    return lines
