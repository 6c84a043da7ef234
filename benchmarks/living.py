"""The sweep over moving walls: `reconstruct` on each film, measured against the wall at rest and by CLiMB's protocol.

    haustra phantom FILMS --living-suite --recordings C3VD_PATHS
    python -m benchmarks.living FILMS/* --json living.json
    python -m benchmarks.living FILMS/* --json living.json --checkout OTHER --name before
    python -m benchmarks.living FILMS/* --json living.json --true-poses --name "true poses"

Frames without news (a camera at rest, red-out) are not tracked and not counted: `informative` are the others. ATE is
CLiMB's: mean distance of camera centres, one Sim(3) a submap, weighted by matched poses; submaps of 20 frames and more
count. F-score, precision and recall are at 1 mm, of the largest submap's mesh, moved by the Sim(3) of its camera poses,
against the wall at rest: of a moving wall no mesh can have them all. A run that is not finished in time is stopped and
its row says so. A row is added as each run ends; a stopped call goes on where it was.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.common.record import ROOT, RunTable, environment, print_row
from benchmarks.common.runner import add_folders, run
from pipeline.climb import compare_climb
from pipeline.compare import compare_run
from pipeline.finished_run import open_run

MIN_COMMON = 20  # frames of a submap that counts
NOT_MEASURED = ("posed", "submaps", "ate_mean_mm", "rotation_40_deg", "f_score_percent")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser)
    parser.add_argument("--checkout", type=Path, default=ROOT, help="the version whose `reconstruct` is run")
    parser.add_argument("--name", default="now", help="what the rows call it")
    parser.add_argument("--front-end", default="auto")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--true-poses", action="store_true", help="give the film's own poses instead of tracking")
    parser.add_argument("--limit-s", type=float, default=900.0, help="after which a run is stopped")
    parser.add_argument("--keep", type=Path, help="folder for the runs, which are removed otherwise")


def measure(arguments: argparse.Namespace) -> None:
    """Every folder once."""
    table, method = RunTable(arguments.json), f"{arguments.name}, {arguments.front_end}"
    if arguments.true_poses:
        method = f"{arguments.name}, true poses"
    for folder in arguments.folders:
        if not table.has(folder.name, arguments.seed, method):
            figures = {"commit": environment(arguments.checkout)["commit"]} | run_figures(folder, arguments)
            table.add(folder.name, arguments.seed, {method: figures})
            print_row({"film": folder.name, "method": method} | figures)


def run_figures(film: Path, arguments: argparse.Namespace) -> dict[str, Any]:
    """One run in a process of its own, measured."""
    with tempfile.TemporaryDirectory() as scratch:
        output = (arguments.keep or Path(scratch)) / f"{film.name}_{arguments.name}"
        command = [sys.executable, "-m", "pipeline", str(film / "video.mp4"), "-o", str(output), "--overwrite", "-q"]
        command += ["--camera", str(film / "camera.json"), "--seed", str(arguments.seed)]
        given = ["--poses", str(film / "trajectory.txt")] if arguments.true_poses else []
        command += given or ["--front-end", arguments.front_end]
        begun = time.perf_counter()
        try:
            done = subprocess.run(
                command,
                cwd=arguments.checkout,
                env=os.environ | {"PYTHONPATH": str(arguments.checkout)},
                capture_output=True,
                text=True,
                timeout=arguments.limit_s,
                check=False,
            )
        except subprocess.TimeoutExpired:
            missing = dict.fromkeys(NOT_MEASURED, None)
            return missing | {"failed": f"not finished in {arguments.limit_s:.0f} s"}
        seconds = time.perf_counter() - begun
        if done.returncode != 0:
            said = f"exit code {done.returncode}: " + " ".join(done.stderr.split())[-300:]
            return dict.fromkeys(NOT_MEASURED, None) | {"seconds": seconds, "failed": said}
        return measured(output, film) | {"seconds": seconds, "failed": None}


def measured(output: Path, film: Path) -> dict[str, Any]:
    """Figures of a finished run."""
    path, whole = compare_climb(output, film, MIN_COMMON), compare_run(output, film)
    assert whole.surface is not None
    measured_mm, metrics = path.measured_ate_mean_mm, open_run(output).metrics
    informative = metrics["frames"]["verdicts"]["used"]
    return {
        "informative": informative,
        "posed": metrics["frames"]["posed"],
        "posed_percent": 100 * metrics["frames"]["posed"] / informative,
        "submaps": len(metrics["submaps"]),
        "ate_mean_mm": path.ate_mean_mm if measured_mm is None else measured_mm,
        "rotation_40_deg": path.relative[-1].rotation_deg,
        "largest_ate_rmse_mm": whole.sim3.ate_rmse,
        "largest_rotation_median_deg": whole.sim3.rotation_median_deg,
        "f_score_percent": 100 * whole.surface.f_score,
        "precision_percent": 100 * whole.surface.precision,
        "recall_percent": 100 * whole.surface.recall,
        "front_end": metrics["front_end"],
    }


if __name__ == "__main__":
    run(sys.modules[__name__], "benchmarks.living")
