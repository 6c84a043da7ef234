"""Both front ends of `reconstruct` on sequences with true poses: what they pose, how well, and how fast.

    haustra phantom SUITE --suite
    python -m benchmarks.reconstruction front-ends SUITE/* ../shared/data/ctcolon --seeds 3 --json front_ends.json
    python -m benchmarks.reconstruction front-ends FOLDER --front-ends odometry --frames 150

Frames are read from `rgb/` with the folder's own camera. Per sequence, front end and seed: frames that were worth
tracking (`used`), the share of them that is posed in any submap, submaps; then errors, after a Sim(3) alignment of each
submap for itself: ATE RMSE over all posed frames, the largest submap's ATE, and the median rotation error. A run counts
as wrong where a submap's median rotation error exceeds 5 degrees. Speed is the structure stage alone (images read from
disk, tracking, adjustment, joining, evidence): frames per second of wall time and processor milliseconds per frame; the
latter is the fairer one on a machine that does other work. Of odometry also what it recorded itself: frames per second
of tracking and local mapping alone. `--guess 100` hides the camera: a guess of so many degrees across the image takes
its place, and the error of the focal length found is printed. `--chunks 4` cuts each film; `--fast` is that of
`reconstruct`.
"""

import argparse
import dataclasses
import json
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.common.front_end import path_errors, processor_seconds, store
from benchmarks.common.record import spread
from benchmarks.common.runner import add_folders, add_seeds
from haustra.core.camera import guess_camera
from haustra.core.errors import HaustraError
from haustra.core.progress import SilentProgress
from pipeline.config import FAST_KEYFRAME_MOTION, Config, FrameSettings, OdometrySettings
from pipeline.frontend.odometry.frame_io import frame_features
from pipeline.frontend.structure_stage import solve_structure
from pipeline.input.frames import Frames
from pipeline.mapping.submap import Submap
from pipeline.run_folder.workspace import Workspace
from reconstruction.evaluation.trajectory_io import read_tum

FRONT_ENDS = ("sfm", "odometry")
# Of these the median and spread over the seeds.
FIGURES = (
    *("posed_share", "submaps", "ate_mm", "rotation_deg", "frames_per_s", "processor_ms_per_frame"),
    *("tracked_per_s", "focal_px", "focal_sigma_px", "focal_error_percent"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser)
    add_seeds(parser, 1)
    parser.add_argument("--front-ends", nargs="+", default=FRONT_ENDS, choices=FRONT_ENDS)
    parser.add_argument("--fast", action="store_true", help="odometry as `reconstruct --fast` has it")
    parser.add_argument("--frames", type=int, help="the first so many frames only")
    parser.add_argument("--guess", type=float, metavar="DEG", help="hide the camera behind a guessed field of view")
    parser.add_argument("--chunks", type=int, default=1, help="that odometry tracks at once")


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Every folder by every front end with every seed."""
    cv2.setNumThreads(1)
    figures: dict[str, Any] = {}
    for folder in arguments.folders:
        for front_end in arguments.front_ends:
            found = summary(list(runs_of(folder, front_end, arguments)))
            figures.setdefault(folder.name, {})[front_end] = found
            print_medians(folder.name, front_end, found)
    about = {"seeds": arguments.seeds, "frames": arguments.frames, "guess_deg": arguments.guess}
    return about | {"chunks": arguments.chunks, "fast": arguments.fast, "figures": figures}


def runs_of(folder: Path, front_end: Any, arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """One run for each seed."""
    _, truth = read_tum(folder / "trajectory.txt")
    fps = json.loads((folder / "camera.json").read_text())["fps"]
    frames = FrameSettings(end_s=None if arguments.frames is None else (arguments.frames - 0.5) / fps)
    odometry = OdometrySettings()
    if front_end == "odometry":
        motion = FAST_KEYFRAME_MOTION if arguments.fast else odometry.keyframe_motion
        odometry = OdometrySettings(chunks=arguments.chunks, keyframe_motion=motion)
    for seed in range(arguments.seeds):
        config = Config(front_end=front_end, seed=seed, frames=frames, odometry=odometry)
        yield {"seed": seed} | run_front_end(folder, config, truth, arguments.guess)


def run_front_end(folder: Path, config: Config, truth: np.ndarray, guess_deg: float | None = None) -> dict[str, Any]:
    """One run of the structure stage and its errors against true poses (N,4,4) in mm."""
    with tempfile.TemporaryDirectory() as scratch:
        frames, workspace = store(folder, config, Path(scratch) / "run")
        true_focal = frames.camera.focal[0]
        frames = frames if guess_deg is None else with_guessed_camera(frames, guess_deg)
        wall, busy = time.perf_counter(), processor_seconds()
        try:
            with frame_features(workspace) as features:
                told = config.front_end_settings
                submaps = solve_structure(frames, features, config.front_end, told, workspace, SilentProgress())
        except HaustraError as error:
            return {"used": len(frames.index), "posed_share": 0.0, "submaps": 0, "failure": str(error)}
        wall, busy = time.perf_counter() - wall, processor_seconds() - busy
    count = len(frames.index)
    return {
        "used": count,
        "posed_share": sum(len(submap.frames) for submap in submaps) / count,
        "submaps": len(submaps),
        "frames_per_s": count / wall,
        **tracking_rate(workspace),
        "processor_ms_per_frame": 1e3 * busy / count,
        **path_errors(submaps, truth),
        **({} if guess_deg is None else lens_errors(submaps[0], true_focal)),
    }


def with_guessed_camera(frames: Frames, guess_deg: float) -> Frames:
    """Frames whose own camera is hidden."""
    width, height = frames.camera.width, frames.camera.height
    return dataclasses.replace(frames, camera=guess_camera(width, height, (0, 0, width, height), guess_deg))


def tracking_rate(workspace: Workspace) -> dict[str, float]:
    """Frames per second of odometry's tracking and local mapping, where the structure stage recorded it."""
    rate = workspace.result("structure").get("stats", {}).get("frames_per_second")
    return {} if rate is None else {"tracked_per_s": rate}


def lens_errors(submap: Submap, true_focal: float) -> dict[str, Any]:
    """The focal length found, its error, and the standard deviation that it came with (for one pixel of noise)."""
    focal, sigma = submap.camera_params[0], submap.camera_sigma[0] if submap.camera_sigma else float("nan")
    return {"focal_px": focal, "focal_sigma_px": sigma, "focal_error_percent": 100 * (focal / true_focal - 1)}


def summary(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Median and spread of each figure over the seeds that gave it."""
    found = {name: [run[name] for run in runs if name in run] for name in FIGURES}
    return {name: spread(values) for name, values in found.items() if values} | {
        "wrong": sum(run.get("wrong", True) for run in runs),
        "runs": runs,
    }


def print_medians(sequence: str, front_end: str, figures: dict[str, Any]) -> None:
    medians = {name: value["median"] for name, value in figures.items() if isinstance(value, dict)}
    text = f"{sequence:16} {front_end:9} posed {100 * medians['posed_share']:5.1f} % in {medians['submaps']:.0f}"
    if "ate_mm" in medians:
        text += f", ATE {medians['ate_mm']:.3f} mm, rotation {medians['rotation_deg']:.2f} deg"
        text += f", {medians['frames_per_s']:.1f} frames/s"
        text += f", {medians['processor_ms_per_frame']:.1f} ms of processor a frame"
    if "tracked_per_s" in medians:
        text += f", tracked at {medians['tracked_per_s']:.1f} frames/s"
    if "focal_px" in medians:
        error, sigma = medians["focal_error_percent"], medians["focal_sigma_px"]
        text += f", focal length {medians['focal_px']:.1f} px ({error:+.1f} %, sigma {sigma:.2g} px)"
    print(f"{text}, wrong {figures['wrong']} of {len(figures['runs'])}", flush=True)
