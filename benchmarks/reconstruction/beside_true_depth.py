"""The mesh of RGB-D films beside what true depth makes on the same poses, one run of `reconstruct` for each seed.

    haustra phantom FILMS --suite --config benchmarks/exposure_films.yaml
    python -m benchmarks.reconstruction beside-true-depth FILMS/* --json exposure.json

F-score at 1 mm, precision and recall as `haustra compare` has them, of the run's own mesh, and of true depth fused
along the same keyframes and poses with the same voxels: what is lost between the two is completion's and fusion's, not
the front end's. Frames are read without loss. Coverage: error of the percentage against the phantom's flags, in points.
A row is added as each run ends; a stopped call goes on where it was.
"""

import argparse
import shutil
import statistics
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.common.record import RunTable, print_row
from benchmarks.common.runner import add_folders, add_seeds
from benchmarks.fusion.depths import DepthSource, true_depth
from benchmarks.fusion.measured_run import MeasuredRun
from pipeline.compare import compare_run
from pipeline.config import load_config
from pipeline.frontend.registry import AUTO, FRONT_ENDS
from pipeline.run import reconstruct
from reconstruction.evaluation.coverage_metrics import CoverageErrors


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser)
    add_seeds(parser, 1)
    parser.add_argument("--model", default="mscsa")
    parser.add_argument("--config", type=Path, help="settings file of the runs, as of `reconstruct --config`")
    parser.add_argument("--front-end", default="odometry", choices=(AUTO, *FRONT_ENDS))
    parser.add_argument("--keep", type=Path, help="folder for the runs, which are removed otherwise")


def measure(arguments: argparse.Namespace) -> None:
    """Every folder with every seed, then the summary."""
    table, method = RunTable(arguments.json), asked_of(arguments)
    for folder in arguments.folders:
        for seed in range(arguments.seeds):
            if not table.has(folder.name, seed, method):
                figures = run_figures(folder, seed, arguments)
                table.add(folder.name, seed, {method: figures})
                print_row({"film": folder.name, "seed": seed} | figures)
    runs = [run for run in table.runs if run["method"] == method]
    shares = [run["of_true_percent"] for run in runs if run["of_true_percent"] is not None]
    scores = [run["f_score_percent"] for run in runs]
    for name, values in (("F", scores), ("of true depth's F", shares)):
        if values:
            middle, mean = statistics.median(values), statistics.fmean(values)
            print(f"{name}: median {middle:.1f} %, mean {mean:.1f} %, least {min(values):.1f} %, {len(values)} runs")


def asked_of(arguments: argparse.Namespace) -> str:
    """The options that a row depends on, by which it is told from others in one file."""
    settings = arguments.config.name if arguments.config else "no settings"
    return f"reconstruct, {arguments.model}, {arguments.front_end}, {settings}"


def run_figures(folder: Path, seed: int, arguments: argparse.Namespace) -> dict[str, Any]:
    """One run, measured; a run that fails has an F of 0 and the sentence that it failed with."""
    with tempfile.TemporaryDirectory() as scratch:
        output = (arguments.keep or Path(scratch)) / f"{folder.name}_{seed}"
        config = load_config(
            arguments.config,
            camera=str(folder / "camera.json"),
            seed=seed,
            model=arguments.model,
            front_end=arguments.front_end,
        )
        try:
            reconstruct(folder, output, config, overwrite=True)
            return measured(output, folder)
        except ValueError as error:  # every known failure
            shutil.rmtree(output, ignore_errors=True)
            return {
                "f_score_percent": 0.0,
                "true_depth_f_score_percent": None,
                "of_true_percent": None,
                "failed": str(error),
            }


def measured(output: Path, folder: Path) -> dict[str, Any]:
    """Figures of a finished run."""
    found = compare_run(output, folder)
    assert found.surface is not None
    true = MeasuredRun(output, folder).measure(DepthSource("true", true_depth, is_true=True))["plain"]["f_score"]
    coverage = found.coverage.error_points if isinstance(found.coverage, CoverageErrors) else None
    return {
        "f_score_percent": 100 * found.surface.f_score,
        "true_depth_f_score_percent": 100 * true,
        "of_true_percent": 100 * found.surface.f_score / true if true else None,
        "precision_percent": 100 * found.surface.precision,
        "recall_percent": 100 * found.surface.recall,
        "posed": found.posed,
        "frames": found.total,
        "ate_mm": found.sim3.ate_rmse,
        "coverage_error_points": coverage,
        "failed": None,
    }
