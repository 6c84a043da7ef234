"""Speed and peak memory of the whole `reconstruct` beside COLMAP + interpolation + TSDF, run in turn.

    python -m benchmarks.speed throughput ../shared/data/ctcolon --runs 3 --json throughput.json
    python -m benchmarks.speed throughput --runs 1      # the demo clip, as `make bench` has it

Both start from the same RGB-D folder and read its images only. Wall time is of the whole process, start-up and report
included; memory is the largest resident sum of the process and its children, sampled twenty times a second. Without a
folder the embedded clip's frames are taken, decoded before the clock starts.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import psutil

from benchmarks.common.record import shown, spread
from pipeline.demo import CAMERA, VIDEO
from pipeline.input.video import Source

PEER = "benchmarks.common.peer_colmap"


def command_time(command: list[str]) -> tuple[float, float]:
    """Wall seconds and peak MiB of a command; raises if it fails."""
    start, peak = time.monotonic(), 0
    process = psutil.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None:
        try:
            family = [process, *process.children(recursive=True)]
            peak = max(peak, sum(member.memory_info().rss for member in family))
        except psutil.NoSuchProcess:
            pass
        time.sleep(0.05)
    if process.returncode:
        raise SystemExit(f"failed with exit code {process.returncode}: {' '.join(command)}")
    return time.monotonic() - start, peak / 2**20


def decode_demo(folder: Path) -> Path:
    """The embedded clip as a folder of images with its camera."""
    (folder / "rgb").mkdir(parents=True)
    shutil.copyfile(CAMERA, folder / "camera.json")
    for frame in Source(VIDEO):
        cv2.imwrite(str(folder / "rgb" / f"{frame.index:05d}.png"), frame.rgb[..., ::-1])
    return folder


def commands(folder: Path, scratch: Path) -> dict[str, list[str]]:
    """What is measured, by name, ours first."""
    ours = [sys.executable, "-m", "pipeline", str(folder), "-o", str(scratch / "run"), "-q"]
    return {"reconstruct": ours, "colmap+linear+tsdf": [sys.executable, "-m", PEER, str(folder), str(scratch / "peer")]}


def times_of(folder: Path, frames: int, runs: int) -> dict[str, list[tuple[float, float]]]:
    """Seconds and MiB of each run of each command, in turn."""
    results: dict[str, list[tuple[float, float]]] = {}
    for run in range(runs):
        with tempfile.TemporaryDirectory() as scratch:
            for name, command in commands(folder, Path(scratch)).items():
                seconds, memory = command_time(command)
                results.setdefault(name, []).append((seconds, memory))
                print(f"run {run} {name:20} {frames / seconds:.2f} frames/s, {memory:.0f} MiB", flush=True)
    return results


def summary(results: dict[str, list[tuple[float, float]]], frames: int) -> dict[str, Any]:
    """Rates and memory of both, and how many times as fast ours is."""
    figures: dict[str, Any] = {
        name: {
            "frames_per_second": spread([frames / seconds for seconds, _ in runs]),
            "peak_mib": spread([memory for _, memory in runs]),
        }
        for name, runs in results.items()
    }
    pairs = zip(*results.values(), strict=True)
    return figures | {"speed_ratio": spread([theirs[0] / ours[0] for ours, theirs in pairs])}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, nargs="?", help="RGB-D folder; the embedded clip if not given")
    parser.add_argument("--runs", type=int, default=3)


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Both, run after run."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = arguments.folder or decode_demo(Path(scratch) / "demo")
        frames = len(list((folder / "rgb").glob("*.png")))
        results = times_of(folder, frames, arguments.runs)
    figures = summary(results, frames)
    for name in results:
        rate, memory = figures[name]["frames_per_second"], figures[name]["peak_mib"]["median"]
        about = f"{arguments.runs} runs of {frames} frames"
        print(f"{name:20} {shown(rate, '.2f')} frames/s, peak {memory:.0f} MiB ({about})")
    print(f"speed ratio {figures['speed_ratio']['median']:.2f}")
    return {"folder": folder.name, "frames": frames, "figures": figures}
