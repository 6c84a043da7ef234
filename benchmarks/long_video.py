"""Long films through the whole of `reconstruct`: time, peak memory, drift of the scale and error of the path.

    haustra phantom WITHDRAWAL --config benchmarks/withdrawal.yaml             # 1,500 frames of 320x320, 450 mm
    haustra phantom LONG --config benchmarks/long_video.yaml --size 320        # 10,000 frames of 320x320, 1.5 m
    python -m benchmarks.long_video WITHDRAWAL --json long_video.json
    python -m benchmarks.long_video LONG --frames 1000 10000 --json long_video.json

Each number of frames is a run of its own from the film's beginning, in a process of its own: `reconstruct --profile`,
default settings, lens given, seed 0. Seconds are of the whole process; the peak is its resident memory, Python and its
libraries included, a COLMAP that is asked for a second opinion not. Path: RMSE of camera centres after one Sim(3) a
submap. Scale: each submap is cut into stretches of `--stretch` mm of true path, one beginning every half stretch, what
is left at the end in none; of submaps with three stretches and more, how far the scale of each stretch's own Sim(3) is
from their median. Where the scale grows evenly, half of the stretches are within a quarter of the whole growth. End
error: a Sim(3) fitted to a stretch's first quarter carries the rest into the truth; distance at its end over length.
A row is added as each run ends; a stopped call goes on where it was. Rendered by `python scripts/pages/long_page.py`.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.front_end import path_errors
from benchmarks.common.record import RunTable, print_row
from benchmarks.common.runner import add_folder, run
from haustra.core.errors import HaustraError
from haustra.core.sim3 import scale_of, transform_points
from pipeline.finished_run import Run, open_run
from pipeline.mapping.submap import Submap
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.evaluation.trajectory_metrics import align_poses

FITTED = 0.25  # of a stretch
MIN_FITTED = 5  # frames
MIN_STRETCHES = 3  # of a submap whose scale is compared with itself
METHOD = "reconstruct"

Array = NDArray[np.float64]


def travelled(poses: Array) -> Array:
    """(N,) length of the path of camera centres up to each of poses (N,4,4)."""
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    return np.concatenate([[0], np.cumsum(steps)])


def stretches(submap: Submap, truth: Array, stretch_mm: float) -> Iterator[tuple[NDArray[np.int64], int]]:
    """Rows of each stretch of a submap, and how many of them make its first quarter; truth (N,4,4), mm."""
    along = travelled(truth[submap.frames])
    for start in np.arange(0, along[-1] - stretch_mm, stretch_mm / 2):
        rows = np.flatnonzero((along >= start) & (along <= start + stretch_mm))
        fitted = int((along[rows] <= start + FITTED * stretch_mm).sum())
        if MIN_FITTED <= fitted < len(rows):
            yield rows, fitted


def drift(submaps: list[Submap], truth: Array, stretch_mm: float) -> dict[str, Any]:
    """Of all stretches: their scales about the median one of their submap, and their end errors, percent: the median
    and the most."""
    scales, ends = [], []
    for submap in submaps:
        own = []
        for rows, fitted in stretches(submap, truth, stretch_mm):
            poses, true = submap.world_from_camera[rows], truth[submap.frames[rows]]
            own.append(float(scale_of(align_poses(poses, true))))
            first = align_poses(poses[:fitted], true[:fitted])
            off = np.linalg.norm(transform_points(first, poses[-1:, :3, 3]) - true[-1, :3, 3])
            ends.append(float(off / travelled(true)[-1]))
        scales += np.abs(np.array(own) / np.median(own) - 1).tolist() if len(own) >= MIN_STRETCHES else []
    return {
        "stretches": len(ends),
        "scale_off_percent": _median_and_most(scales),
        "end_error_percent": _median_and_most(ends),
    }


def _median_and_most(shares: list[float]) -> list[float] | None:
    """In percent; None of none."""
    return [float(100 * np.median(shares)), float(100 * np.max(shares))] if shares else None


def figures_of(film: Path, made: Run, frames: int, seconds: float, stretch_mm: float) -> dict[str, Any]:
    """Of one finished run with a profile."""
    _, truth = read_tum(film / "trajectory.txt")
    metrics, submaps = made.metrics, [completed.submap for completed in made.completed_submaps]
    return {
        "frames": frames,
        "used": metrics["frames"]["verdicts"]["used"],
        "posed": metrics["frames"]["posed"],
        "submaps": len(submaps),
        "keyframes": sum(submap["keyframes"] for submap in metrics["submaps"]),
        "path_mm": float(travelled(truth[:frames])[-1]),
        "seconds": seconds,
        "frames_per_s": frames / seconds,
        "peak_mib": max(stage["peak_mib"] for stage in metrics["profile"]),
        "stages": {stage["stage"]: [stage["seconds"], stage["peak_mib"]] for stage in metrics["profile"]},
        **drift(submaps, truth, stretch_mm),
        **path_errors(submaps, truth),
    }


def measured(film: Path, frames: int, stretch_mm: float) -> dict[str, Any]:
    """Run the first `frames` frames of an RGB-D folder, and measure."""
    fps = json.loads((film / "camera.json").read_text())["fps"]
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "run"
        command = [sys.executable, "-m", "pipeline", str(film), "-o", str(folder), "--profile", "-q"]
        command += ["--camera", str(film / "camera.json"), "--end", f"{(frames - 0.5) / fps:.6f}"]
        started = time.perf_counter()
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        seconds = time.perf_counter() - started
        if done.returncode != 0:
            raise HaustraError(f"{film}, {frames} frames: {done.stderr.strip()}")
        return figures_of(film, open_run(folder), frames, seconds, stretch_mm)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folder(parser)
    parser.add_argument("--frames", type=int, nargs="+", help="each a run of its own (default: the whole film)")
    parser.add_argument("--stretch", type=float, default=100.0, help="mm")


def measure(arguments: argparse.Namespace) -> None:
    """A run for each number of frames."""
    film, table = arguments.folder, RunTable(arguments.json)
    for frames in arguments.frames or [len(read_tum(film / "trajectory.txt")[0])]:
        name = f"{film.name}, {frames} frames, stretches of {arguments.stretch:g} mm"
        if table.has(name, 0, METHOD):
            continue
        figures = measured(film, frames, arguments.stretch)
        table.add(name, 0, {METHOD: {"stretch_mm": arguments.stretch} | figures})
        print_row({"film": name} | {key: value for key, value in figures.items() if key != "stages"})


if __name__ == "__main__":
    run(sys.modules[__name__], "benchmarks.long_video")
