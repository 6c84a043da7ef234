"""Speed, peak memory and accuracy of the whole `reconstruct` beside COLMAP + interpolation + TSDF, run in turn.

    python -m benchmarks.speed throughput ../shared/data/ctcolon --runs 3 --json throughput.json
    python -m benchmarks.speed throughput CTCOLON SUITE/* --before CHECKOUT --runs 3 --json speed.json
    python -m benchmarks.speed throughput --runs 1      # the demo clip, as `make bench` has it

All start from the same RGB-D folder and read its images only: `reconstruct` by default, with `--fast`, by the version
of another checkout (`--before`), and the peer. They take turns, run after run, so that a machine whose speed drifts
slows all of them alike; before the first turn each runs once uncounted. Wall time is of the whole process, start-up and
report included; memory is the largest resident sum of the process and its children, sampled twenty times a second.
F-score at 1 mm and ATE of each run come from `haustra compare`, outside the clock; the peer's are not measured here.
Without a folder the embedded clip's frames are taken, decoded before the clock starts.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import psutil

from benchmarks.common.record import ROOT, environment, shown, spread
from haustra.core.errors import HaustraError
from pipeline.compare import compare_run
from pipeline.demo import CAMERA, VIDEO
from pipeline.input.video import Source

PEER = "benchmarks.common.peer_colmap"


def command_time(command: list[str], checkout: Path = ROOT) -> tuple[float, float]:
    """Wall seconds and peak MiB of a command that imports this project from a checkout; raises if it fails."""
    start, peak = time.monotonic(), 0
    environment = os.environ | {"PYTHONPATH": str(checkout)}
    process = psutil.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment, cwd="/")
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


@dataclass(frozen=True)
class Method:
    """A command that makes a run of a folder (`{folder}`) in `{out}`, and the checkout that it imports."""

    name: str
    command: tuple[str, ...]
    checkout: Path = ROOT
    is_ours: bool = True

    def of(self, folder: Path, out: Path) -> list[str]:
        """The command of one run."""
        return [sys.executable, *(word.format(folder=folder, out=out) for word in self.command)]


def methods(before: Path | None) -> list[Method]:
    """All that take turns, this version first."""
    ours = ("-m", "pipeline", "{folder}", "-o", "{out}", "-q")
    found = [Method("reconstruct", ours), Method("reconstruct --fast", (*ours, "--fast"))]
    if before is not None:
        found.append(Method("before", ours, before.resolve()))
    return [*found, Method("colmap+linear+tsdf", ("-m", PEER, "{folder}", "{out}"), is_ours=False)]


def runs_of(folder: Path, truth: Path, all_methods: list[Method], runs: int) -> list[dict[str, Any]]:
    """One row a run of each method, in turn."""
    frames, rows = len(list((folder / "rgb").glob("*.png"))), []
    for number in range(runs):
        with tempfile.TemporaryDirectory() as scratch:
            for method in all_methods:
                out = Path(scratch) / method.name.replace(" ", "_")
                seconds, memory = command_time(method.of(folder.resolve(), out), method.checkout)
                row = {"film": folder.name, "method": method.name, "run": number, "frames": frames}
                row |= {"seconds": seconds, "peak_mib": memory} | (_errors(out, truth) if method.is_ours else {})
                print(f"{folder.name} {method.name:20} {frames / seconds:.2f} frames/s, {memory:.0f} MiB", flush=True)
                rows.append(row)
    return rows


def _errors(run: Path, truth: Path) -> dict[str, float | None]:
    """F-score and ATE of a run; None where the folder has no truth."""
    try:
        found = compare_run(run, truth)
    except HaustraError:
        return {"f_score_percent": None, "ate": None}
    score = None if found.surface is None else 100 * found.surface.f_score
    return {"f_score_percent": score, "ate": found.sim3.ate_rmse}


def summary(rows: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Of one film: each method's rate, memory and errors, and in each turn how many times as long it took as ours."""
    by_method: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        by_method.setdefault(row["method"], []).append(row)
    ours = next(iter(by_method.values()))
    figures = {}
    for name, mine in by_method.items():
        figures[name] = {
            "frames_per_second": spread([row["frames"] / row["seconds"] for row in mine]),
            "peak_mib": spread([row["peak_mib"] for row in mine]),
            "times_ours": spread([row["seconds"] / own["seconds"] for row, own in zip(mine, ours, strict=True)]),
        }
        for figure in ("f_score_percent", "ate"):
            known = [row[figure] for row in mine if row.get(figure) is not None]
            if known:
                figures[name][figure] = spread(known)
    return figures


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folders", type=Path, nargs="*", help="RGB-D folders; the embedded clip if none is given")
    parser.add_argument("--before", type=Path, help="checkout of another version, measured beside this one")
    parser.add_argument("--runs", type=int, default=3)


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """All methods on all films, run after run."""
    all_methods, films, rows = methods(arguments.before), {}, []
    with tempfile.TemporaryDirectory() as scratch:
        folders = arguments.folders or [decode_demo(Path(scratch) / "demo")]
        for number, method in enumerate(all_methods):  # once uncounted: a fresh checkout compiles its loops
            command_time(method.of(folders[0].resolve(), Path(scratch) / f"warm_{number}"), method.checkout)
        for folder in folders:
            mine = runs_of(folder, folder, all_methods, arguments.runs)
            rows += mine
            films[folder.name] = summary(mine)
            for name, figure in films[folder.name].items():
                rate, memory = figure["frames_per_second"], figure["peak_mib"]["median"]
                print(
                    f"{folder.name} {name:20} {shown(rate, '.2f')} frames/s, peak {memory:.0f} MiB, "
                    f"{figure['times_ours']['median']:.2f} times as long as the first"
                )
    before = None if arguments.before is None else environment(arguments.before)["commit"]
    return {"before": before, "films": films, "runs": rows}
