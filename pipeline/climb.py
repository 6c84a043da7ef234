"""A run in CLiMB: its submission tree, and its errors against a reference by that benchmark's protocol.

The tree is 3D_maps/NNN/points3D.txt, camera_trajectory/cam_traj_map_NNN.txt and runtime.txt, as the benchmark's
submission instructions have it. Frames are numbered from 1.
"""

import re
import shutil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from haustra.core.errors import HaustraError
from haustra.core.se3 import interpolated
from pipeline.compare import true_path
from pipeline.finished_run import Run, open_run
from pipeline.input.pose_files.colmap_poses import read_colmap_poses
from pipeline.input.pose_files.pairing import paired
from pipeline.input.pose_files.pose_table import FilmFrames
from reconstruction.evaluation.climb import MIN_COMMON, ClimbErrors, climb_errors

Array = NDArray[np.float64]
HEADER = "# timestamp, name_image, tx, ty, tz, qw, qx, qy, qz, interpolated\n"


def compare_climb(run: Path, reference: Path, min_common: int = MIN_COMMON) -> ClimbErrors:
    """Errors of a finished run against a path: an RGB-D folder, a TUM file, or the images.txt of a COLMAP model in mm,
    whose pictures are numbered from 1. Poses that a submission would interpolate do not count as tracked here."""
    finished = open_run(run)
    film = FilmFrames.of(finished.workspace)
    submaps = [(finished.submaps[k].frames + 1, finished.trajectory(k)[1]) for k in range(len(finished.surfaces))]
    if reference.name == "images.txt":
        truth = read_numbered_images(reference)
    else:
        true_seconds, world_from_camera = true_path(reference, finished)
        mine, theirs = paired(film.seconds, true_seconds, reference)
        truth = film.index[mine] + 1, world_from_camera[theirs]
    fps = 1 / float(np.median(np.diff(film.seconds)))
    loop = loop_seconds(finished)
    return climb_errors(submaps, truth, fps, None if loop is None else loop / len(film.index), min_common)


def write_submission(run: Path, folder: Path) -> Path:
    """Write one run folder of a submission. Raises `HaustraError` where the folder holds something else, or the run
    does not say how long its frame loop took. A run does not record the time before that loop, which the benchmark does
    not score: init_seconds is 0. An earlier submission in the folder is replaced."""
    finished = open_run(run)
    loop = loop_seconds(finished)
    if loop is None:
        raise HaustraError(f"{run} does not say how long its frame loop took, which runtime.txt needs; use odometry")
    if folder.exists() and any(folder.iterdir()) and not (folder / "runtime.txt").exists():
        raise HaustraError(f"{folder} holds something else; give another folder")
    paths, maps = folder / "camera_trajectory", folder / "3D_maps"
    for part in (paths, maps):
        shutil.rmtree(part, ignore_errors=True)  # an earlier run's submaps would be read as this one's
        part.mkdir(parents=True)
    film = FilmFrames.of(finished.workspace)
    taken = {int(frame) for submap in finished.submaps for frame in submap.frames}
    for number, submap in enumerate(finished.submaps):
        posed, world_from_camera = submap.frames, finished.trajectory(number)[1]
        inside = film.index[(film.index > posed[0]) & (film.index < posed[-1])]
        between = np.array([frame for frame in inside.tolist() if frame not in taken], np.int64)
        table = _lines(film, posed, world_from_camera, between)
        (paths / f"cam_traj_map_{number:03d}.txt").write_text(HEADER + "".join(table))
        target = maps / f"{number:03d}"
        target.mkdir()
        points = submap.points * finished.surfaces[number].scale.factor
        rows = (f"{k} {x:.6f} {y:.6f} {z:.6f} 128 128 128 0\n" for k, (x, y, z) in enumerate(points, start=1))
        (target / "points3D.txt").write_text("# POINT3D_ID, X, Y, Z, R, G, B, ERROR\n" + "".join(rows))
    runtime = f"init_seconds=0\nprocessing_seconds={loop:.6f}\n"
    (folder / "runtime.txt").write_text(runtime)
    return folder


def read_numbered_images(path: Path) -> tuple[NDArray[np.int64], Array]:
    """Last numbers (N,) in the pictures' names and world_from_camera (N,4,4) of a COLMAP images.txt."""
    table = read_colmap_poses(path)
    numbers = [re.findall(r"\d+", Path(name).stem) for name in (table.names if table else None) or ()]
    if table is None or not all(numbers):
        raise HaustraError(f"{path}: not an images.txt of COLMAP with numbered pictures")
    return np.array([int(found[-1]) for found in numbers]), table.world_from_camera


def loop_seconds(run: Run) -> float | None:
    """Wall time of tracking and local mapping; None of a front end without a frame loop. Frames that were left out
    before, such as blurred ones, were not in it."""
    pace = run.workspace.result("structure").get("stats", {}).get("frames_per_second")
    return len(run.frames.index) / float(pace) if pace else None


def _lines(
    film: FilmFrames, posed: NDArray[np.int64], world_from_camera: Array, between: NDArray[np.int64]
) -> list[str]:
    """A submap's lines in the order of its frames, with the frames `between` interpolated: centres on the straight
    line, rotations on the great arc between the posed neighbours."""
    times, wanted = (film.seconds[np.searchsorted(film.index, frames)] for frames in (posed, between))
    poses, marks = world_from_camera, [0] * len(posed) + [1] * len(between)
    if len(between):
        poses = np.concatenate([poses, interpolated(times, world_from_camera, wanted)])
    turns = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    frames, seconds = (np.concatenate(parts).tolist() for parts in ((posed, between), (times, wanted)))
    lines = []
    for frame, time, centre, (x, y, z, w), mark in sorted(
        zip(frames, seconds, poses[:, :3, 3], turns, marks, strict=True), key=lambda entry: entry[0]
    ):
        place = ",".join(f"{value:.9f}" for value in (*centre, w, x, y, z))
        lines.append(f"{time:.6f},{frame + 1:06d}.png,{place},{mark}\n")
    return lines
