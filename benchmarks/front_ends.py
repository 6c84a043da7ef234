"""Both front ends of `reconstruct` on sequences with true poses: what they pose, how well, and how fast.

    haustra phantom SUITE --suite
    python -m benchmarks.front_ends SUITE/* ../shared/data/ctcolon --seeds 3 --json front_ends.json
    python -m benchmarks.front_ends FOLDER --front-ends odometry --frames 150

Frames are read from `rgb/` with the folder's own camera. Per sequence, front end and seed: frames that were worth
tracking (`used`), the share of them that is posed in any submap, submaps; then errors, after a Sim(3) alignment of each
submap for itself: ATE RMSE over all posed frames, the largest submap's ATE, and the median rotation error. A run counts
as wrong where a submap's median rotation error exceeds 5 degrees. Speed is the structure stage alone (images read from
disk, tracking, adjustment, joining, evidence): frames per second of wall time and processor milliseconds per frame; the
latter is the fairer one on a machine that does other work. Of odometry also what it says itself: frames per second of
tracking and local mapping alone. `--guess 100` hides the camera: a guess of so many degrees across the image takes its
place, and the error of the focal length found is printed. `--chunks 4` cuts each film;
`--fast` is that of `reconstruct`.
"""

import argparse
import dataclasses
import json
import os
import re
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.record import spread, write
from haustra.core.camera import Camera, guess_camera
from haustra.core.errors import HaustraError
from haustra.core.progress import SilentProgress
from haustra.core.ray_table import RayTable
from pipeline.config import FAST_KEYFRAME_MOTION, Config, FrameSettings, OdometrySettings
from pipeline.frontend.odometry.state_machine import Odometry
from pipeline.frontend.select import solve_structure
from pipeline.input.frames import Frames, read_frames
from pipeline.input.video import Source
from pipeline.mapping.local_map import LocalMap
from pipeline.mapping.submap import Submap
from pipeline.matching.sift_cache import ReadFrame
from pipeline.run_folder.workspace import Workspace, create_workspace
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.evaluation.trajectory_metrics import trajectory_errors

WRONG_DEG = 5.0
MIN_FRAMES = 3  # for an alignment


class Hearing(SilentProgress):
    """Keeps the rate at which odometry says that it tracked."""

    tracked_per_s: float | None = None

    def say(self, sentence: str) -> None:
        found = re.match(r"odometry at ([0-9.]+) frames a second", sentence)
        self.tracked_per_s = float(found[1]) if found else self.tracked_per_s


def store(folder: Path, config: Config, root: Path) -> tuple[Frames, Workspace]:
    workspace = create_workspace(root, folder, config, overwrite=True)
    return read_frames(Source(folder), config, workspace, SilentProgress()), workspace


def tracked_maps(camera: Camera, read: ReadFrame, index: NDArray[np.int64]) -> list[LocalMap]:
    """The maps of these frames as odometry's tracking leaves them."""
    odometry = Odometry(RayTable(camera), 0)
    for frame in index.tolist():
        rgb, mask = read(frame)
        odometry.feed(frame, rgb, odometry.view(rgb, mask))
    return odometry.finish()


def processor_seconds() -> float:
    """Of this process and of the children that have ended: COLMAP runs in one."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


def run(folder: Path, config: Config, truth: np.ndarray, guess_deg: float | None = None) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as scratch:
        frames, workspace = store(folder, config, Path(scratch) / "run")
        true = frames.camera
        if guess_deg is not None:
            guess = guess_camera(true.width, true.height, (0, 0, true.width, true.height), guess_deg)
            frames = dataclasses.replace(frames, camera=guess)
        heard = Hearing()
        wall, busy = time.perf_counter(), processor_seconds()
        try:
            submaps = solve_structure(frames, config, workspace, heard)
        except HaustraError as error:
            return {"used": len(frames.index), "posed_share": 0.0, "submaps": 0, "failure": str(error)}
        wall, busy = time.perf_counter() - wall, processor_seconds() - busy
    count = len(frames.index)
    return {
        "used": count,
        "posed_share": sum(len(submap.frames) for submap in submaps) / count,
        "submaps": len(submaps),
        "frames_per_s": count / wall,
        **({} if heard.tracked_per_s is None else {"tracked_per_s": heard.tracked_per_s}),
        "processor_ms_per_frame": 1e3 * busy / count,
        **errors_of(submaps, truth),
        **({} if guess_deg is None else lens_of(submaps[0], true.focal[0])),
    }


def lens_of(submap: Submap, true_focal: float) -> dict[str, Any]:
    """The focal length found, its error, and the standard deviation that it came with (for one pixel of noise)."""
    focal, sigma = submap.camera_params[0], submap.camera_sigma[0] if submap.camera_sigma else float("nan")
    return {"focal_px": focal, "focal_sigma_px": sigma, "focal_error_percent": 100 * (focal / true_focal - 1)}


def errors_of(submaps: list[Submap], truth: np.ndarray) -> dict[str, Any]:
    """Each submap aligned for itself, since each has a frame and a scale of its own."""
    judged = [
        (len(submap.frames), trajectory_errors(submap.world_from_camera, truth[submap.frames]))
        for submap in submaps
        if len(submap.frames) >= MIN_FRAMES
    ]
    if not judged:
        return {}
    total = sum(count for count, _ in judged)
    return {
        "ate_mm": float(np.sqrt(sum(count * e.ate_rmse**2 for count, e in judged) / total)),
        "largest": {"frames": judged[0][0], "ate_mm": judged[0][1].ate_rmse},
        "rotation_deg": float(np.average([e.rotation_median_deg for _, e in judged], weights=[c for c, _ in judged])),
        "wrong": any(e.rotation_median_deg > WRONG_DEG for _, e in judged),
    }


def summary(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Median and spread of each figure over the seeds that gave it."""
    names = ("posed_share", "submaps", "ate_mm", "rotation_deg", "frames_per_s", "processor_ms_per_frame")
    names += ("tracked_per_s", "focal_px", "focal_sigma_px", "focal_error_percent")
    found = {name: [run[name] for run in runs if name in run] for name in names}
    return {name: spread(values) for name, values in found.items() if values} | {
        "wrong": sum(run.get("wrong", True) for run in runs),
        "runs": runs,
    }


def print_row(sequence: str, front_end: str, figures: dict[str, Any]) -> None:
    medians = {name: value["median"] for name, value in figures.items() if isinstance(value, dict)}
    print(f"{sequence:16} {front_end:9} posed {100 * medians['posed_share']:5.1f} %", end="")
    print(f" in {medians['submaps']:.0f}", end="")
    if "ate_mm" in medians:
        print(f", ATE {medians['ate_mm']:.3f} mm, rotation {medians['rotation_deg']:.2f} deg", end="")
        print(f", {medians['frames_per_s']:.1f} frames/s", end="")
        print(f", {medians['processor_ms_per_frame']:.1f} ms of processor a frame", end="")
    if "tracked_per_s" in medians:
        print(f", tracked at {medians['tracked_per_s']:.1f} frames/s", end="")
    if "focal_px" in medians:
        error, sigma = medians["focal_error_percent"], medians["focal_sigma_px"]
        print(f", focal length {medians['focal_px']:.1f} px ({error:+.1f} %, sigma {sigma:.2g} px)", end="")
    print(f", wrong {figures['wrong']} of {len(figures['runs'])}", flush=True)


def odometry_of(arguments: argparse.Namespace) -> OdometrySettings:
    motion = FAST_KEYFRAME_MOTION if arguments.fast else OdometrySettings().keyframe_motion
    return OdometrySettings(chunks=arguments.chunks, keyframe_motion=motion)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folders", type=Path, nargs="+", help="RGB-D folders")
    parser.add_argument("--front-ends", nargs="+", default=["sfm", "odometry"], choices=["sfm", "odometry"])
    parser.add_argument("--fast", action="store_true", help="odometry as `reconstruct --fast` has it")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--frames", type=int, help="the first so many frames only")
    parser.add_argument("--guess", type=float, metavar="DEG", help="hide the camera behind a guessed field of view")
    parser.add_argument("--chunks", type=int, default=1, help="that odometry tracks at once")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    figures: dict[str, Any] = {}
    for folder in arguments.folders:
        _, truth = read_tum(folder / "trajectory.txt")
        fps = json.loads((folder / "camera.json").read_text())["fps"]
        end = None if arguments.frames is None else (arguments.frames - 0.5) / fps
        for front_end in arguments.front_ends:
            runs = []
            for seed in range(arguments.seeds):
                frames = FrameSettings(end_s=end)
                odometry = odometry_of(arguments) if front_end == "odometry" else OdometrySettings()
                config = Config(front_end=front_end, seed=seed, frames=frames, odometry=odometry)
                runs.append({"seed": seed} | run(folder, config, truth, arguments.guess))
            figures.setdefault(folder.name, {})[front_end] = summary(runs)
            print_row(folder.name, front_end, figures[folder.name][front_end])
    write(
        arguments.json,
        {"seeds": arguments.seeds, "frames": arguments.frames, "guess_deg": arguments.guess}
        | {"chunks": arguments.chunks, "fast": arguments.fast, "figures": figures},
    )


if __name__ == "__main__":
    main()
