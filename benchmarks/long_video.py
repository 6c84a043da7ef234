"""A long video through odometry: peak memory against the number of frames, submaps, and drift per length of path.

    haustra phantom FILM --config benchmarks/long_video.yaml --size 160     # 10,000 frames of a 1.5 m colon
    python -m benchmarks.long_video FILM --frames 1000 10000 --json long_video.json

Each number of frames runs in a process of its own (decoding and judging the frames, tracking, mapping, joining,
evidence; no depth), whose peak resident memory is printed: Python and its libraries included, COLMAP not, as it does
not run. Drift: each submap is cut into stretches of `--stretch` mm of true path, one beginning every half stretch; a
similarity fitted to a stretch's first quarter carries the rest into the truth, and the distance at its end is divided
by its length. Median and 90th percentile over all stretches.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.common.front_end import path_errors, store
from benchmarks.common.runner import add_folder, run
from haustra.core.progress import SilentProgress
from pipeline.config import Config, FrameSettings
from pipeline.frontend.odometry.frame_io import frame_features
from pipeline.frontend.structure_stage import solve_structure
from pipeline.mapping.submap import Submap
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.evaluation.trajectory_metrics import align_poses

FITTED = 0.25  # of a stretch
MIN_FITTED = 5  # frames


def drifts(submaps: list[Submap], truth: np.ndarray, stretch_mm: float) -> list[float]:
    """End error of every stretch over its length."""
    found = []
    for submap in submaps:
        true = truth[submap.frames]
        along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(true[:, :3, 3], axis=0), axis=1))])
        for start in np.arange(0, along[-1] - stretch_mm, stretch_mm / 2):
            rows = np.flatnonzero((along >= start) & (along <= start + stretch_mm))
            fitted = rows[along[rows] <= start + FITTED * stretch_mm]
            if len(fitted) < MIN_FITTED:
                continue
            truth_from_run = align_poses(submap.world_from_camera[fitted], true[fitted])
            end = truth_from_run[:3, :3] @ submap.centres[rows[-1]] + truth_from_run[:3, 3]
            found.append(float(np.linalg.norm(end - true[rows[-1], :3, 3]) / (along[rows[-1]] - along[rows[0]])))
    return found


def track(folder: Path, frames: int, stretch_mm: float) -> dict[str, Any]:
    _, truth = read_tum(folder / "trajectory.txt")
    fps = json.loads((folder / "camera.json").read_text())["fps"]
    config = Config(front_end="odometry", frames=FrameSettings(end_s=(frames - 0.5) / fps))
    with tempfile.TemporaryDirectory() as scratch:
        kept, workspace = store(folder, config, Path(scratch) / "run")
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        start = time.perf_counter()
        with frame_features(workspace) as features:
            told = config.front_end_settings
            submaps = solve_structure(kept, features, config.front_end, told, workspace, SilentProgress())
        seconds = time.perf_counter() - start
    drift = drifts(submaps, truth, stretch_mm)
    return {
        "frames": frames,
        "worth_tracking": len(kept.index),
        "posed": sum(len(submap.frames) for submap in submaps),
        "submaps": len(submaps),
        "path_mm": float(np.linalg.norm(np.diff(truth[:frames, :3, 3], axis=0), axis=1).sum()),
        "peak_mebibytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "peak_before_structure_mebibytes": before,
        "frames_per_s": len(kept.index) / seconds,
        "stretches": len(drift),
        "drift_median": float(np.median(drift)) if drift else None,
        "drift_90": float(np.percentile(drift, 90)) if drift else None,
        **path_errors(submaps, truth),
    }


def in_a_process(folder: Path, frames: int, stretch_mm: float) -> dict[str, Any]:
    command = [sys.executable, "-m", "benchmarks.long_video", str(folder)]
    command += ["--frames", str(frames), "--stretch", str(stretch_mm), "--here"]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1])


def print_run(of: dict[str, Any], stretch_mm: float) -> None:
    text = f"{of['frames']} frames, {of['path_mm']:.0f} mm: peak {of['peak_mebibytes']:.0f} MiB "
    text += f"({of['peak_before_structure_mebibytes']:.0f} before structure), {of['posed']} of {of['worth_tracking']} "
    text += f"posed in {of['submaps']} submaps, {of['frames_per_s']:.1f} frames/s"
    if of["drift_median"] is not None:
        text += f"; drift {100 * of['drift_median']:.1f} % of the path in the median, {100 * of['drift_90']:.1f} % at "
        text += f"the 90th percentile ({of['stretches']} stretches of {stretch_mm:.0f} mm)"
    print(text, flush=True)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folder(parser)
    parser.add_argument("--frames", type=int, nargs="+", default=[1000, 10000], help="each in a process of its own")
    parser.add_argument("--stretch", type=float, default=100.0, help="mm")
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)  # in this process, as JSON


def measure(arguments: argparse.Namespace) -> dict[str, Any] | None:
    """A run for each number of frames."""
    cv2.setNumThreads(1)
    if arguments.here:
        print(json.dumps(track(arguments.folder, arguments.frames[0], arguments.stretch)))
        return None
    runs = [in_a_process(arguments.folder, frames, arguments.stretch) for frames in arguments.frames]
    for figures in runs:
        print_run(figures, arguments.stretch)
    return {"stretch_mm": arguments.stretch, "runs": runs}


if __name__ == "__main__":
    run(sys.modules[__name__], "benchmarks.long_video")
