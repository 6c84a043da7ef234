"""How far from a depth its voxels are updated: finished runs fused anew at several truncations, measured against truth.

    python -m benchmarks.fusion truncation RUN=FOLDER... --role chosen --json truncation.json

RUN must be a finished run of the RGB-D folder's frames. Its keyframes, poses, voxels and completed depth stay, with
consistency and confidence as in a run, but spots too dark for their depth are not left open. Surfaces are compared as
`haustra compare` does. Runs are added to the record as they are measured.
"""

import argparse
import statistics
from dataclasses import replace

import cv2
import numpy as np

from benchmarks.common.record import RunTable, in_percent, print_row
from benchmarks.fusion.comparison import pair
from benchmarks.fusion.measured_run import TAU, MeasuredRun, ranges
from reconstruction.evaluation.surface_metrics import surface_errors

TRUNCATIONS = (12.0, 8.0, 6.0, 5.0, 4.0, 3.0)  # voxels


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("pairs", metavar="RUN=FOLDER", type=pair, nargs="+", help="finished run and its RGB-D folder")
    parser.add_argument("--role", default="reported", choices=("reported", "chosen"), help="what the films are to it")


def measure(arguments: argparse.Namespace) -> None:
    """Every run at every truncation, then the means."""
    cv2.setNumThreads(1)
    table = RunTable(arguments.json)
    for run, folder in arguments.pairs:
        if table.has(folder.name, 0, arguments.role):
            continue
        opened = MeasuredRun(run, folder)
        found = scores(opened)
        table.add(folder.name, 0, {arguments.role: {"voxel_mm": opened.about["voxel_mm"], "truncations": found}})
        print_row({"film": folder.name} | {voxels: figures["f_score"] for voxels, figures in found.items()})
    mine = [run["truncations"] for run in table.runs if run["method"] == arguments.role]
    for voxels in mine[0]:
        values = [of_film[voxels]["f_score"] for of_film in mine]
        print(f"{voxels} voxels: mean {statistics.fmean(values):.2f}, median {statistics.median(values):.2f} % F")


def scores(run: MeasuredRun) -> dict[str, dict[str, float]]:
    """F-score, precision and recall (%) of a run's own depth at each truncation."""
    own, settings = run.with_own_depth(), ranges(run.after.completed, run.config)
    kept, found = own.kept(True, True, run.config), {}
    for voxels in TRUNCATIONS:
        mesh = own.surface(kept, replace(settings, truncation=voxels))
        found[f"{voxels:g}"] = in_percent(surface_errors(mesh, run.truth, TAU, np.random.default_rng(0)))
    return found
