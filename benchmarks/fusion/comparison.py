"""What depth, and each part of the fusion, is worth to the mesh: finished runs fused anew and measured against truth.

    python -m benchmarks.fusion comparison RUN=FOLDER... --model "MSCSA-Net=W.safetensors" --json fusion.json

RUN must be a finished run of the RGB-D folder's frames. Its keyframes, poses and voxels are fused with linear
interpolation of its sparse points, what each `--model` makes of them, the depth that the run wrote, and true depth;
each without and with consistency between keyframes and confidence as weights, and, where closing loops moved the map,
without that. Surfaces are compared as `haustra compare` does. docs/lab/fusion.md explains the columns.

A `--model` of the paper's kind is given the sparse points in true millimetres, which no run knows, on a picture of
`--side` px, which must be what it was trained at (`benchmarks.paper`: 160). It has no confidence, and neither have
interpolated and true depth.
"""

import argparse
import statistics
import sys
import time
from pathlib import Path
from typing import Any

import cv2

from benchmarks.common.record import write
from benchmarks.fusion.depths import depth_sources
from benchmarks.fusion.measured_run import UNMOVED, VARIANTS, Figures, MeasuredRun

COLUMNS = [*VARIANTS, UNMOVED]
NOISE = 0.1  # points of F; the mesh sampled by five other seeds gave a standard deviation of 0.04
# Name of a part, and the columns without and with it; without the pose graph everything else is on that the depth has.
PARTS = {
    "consistency, alone": ("plain", "consistency"),
    "consistency, on top of confidence": ("confidence", "both"),
    "confidence, alone": ("plain", "confidence"),
    "confidence, on top of consistency": ("consistency", "both"),
    "consistency and confidence": ("plain", "both"),
    "pose graph, on top of all": (UNMOVED, None),
}
Depths = dict[str, dict[str, Figures]]  # depth -> column -> figures


def fullest(columns: dict[str, Figures]) -> str:
    """The last column that a depth has with the map as refined."""
    return [name for name in VARIANTS if name in columns][-1]


def changes(depths: Depths) -> dict[str, dict[str, float]]:
    """Part -> depth -> change of F in points, in one run; what it lacks is left out."""
    found: dict[str, dict[str, float]] = {part: {} for part in PARTS}
    for depth, columns in depths.items():
        for part, (without, named) in PARTS.items():
            with_it = named or fullest(columns)
            if without in columns and with_it in columns:
                found[part][depth] = 100 * (columns[with_it]["f_score"] - columns[without]["f_score"])
    return found


def summarised(runs: dict[str, Depths]) -> dict[str, dict[str, Figures]]:
    """Part -> depth -> change of F in points over the runs that have both sides: median, extremes, how many runs have
    them, and in how many F rises and falls by more than the noise."""
    each = [changes(depths) for depths in runs.values()]
    summary = {}
    for part in PARTS:
        names = dict.fromkeys(depth for run in each for depth in run[part])
        summary[part] = {depth: spread_of([run[part][depth] for run in each if depth in run[part]]) for depth in names}
    return summary


def spread_of(values: list[float]) -> Figures:
    return {
        "median": statistics.median(values),
        "min": min(values),
        "max": max(values),
        "helps": sum(value > NOISE for value in values),
        "hurts": sum(value < -NOISE for value in values),
        "runs": len(values),
    }


def table(runs: dict[str, Depths], about: dict[str, Figures]) -> str:
    """Markdown, a row for each run and depth: F at 1 mm in %, mean accuracy and completeness in mm."""
    lines = [f"| run | depth | {' | '.join(COLUMNS)} |", "|---" * (2 + len(COLUMNS)) + "|"]
    for run, depths in runs.items():
        of = about[run]
        for row, (depth, columns) in enumerate(depths.items()):
            label = f"{run} ({of['posed']} of {of['film']} frames)" if row == 0 else ""
            cells = [cell(columns[name]) if name in columns else "" for name in VARIANTS]
            unmoved = cell(columns[UNMOVED]) if UNMOVED in columns else of["refinement"]
            lines.append(f"| {label} | {depth} | {' | '.join(cells)} | {unmoved} |")
    return "\n".join(lines)


def cell(figures: Figures) -> str:
    distances = (figures["accuracy_mean"], figures["completeness_mean"])
    return " / ".join([f"{100 * figures['f_score']:.1f}", *("-" if d is None else f"{d:.2f}" for d in distances)])


def summary_table(summary: dict[str, dict[str, Figures]]) -> str:
    """Markdown, a row for each part and depth that some run has."""
    lines = ["| part | depth | change of F, points: median (least to most) | helps | hurts |", "|---" * 5 + "|"]
    for part, depths in summary.items():
        if not depths:
            lines.append(f"| {part} | | not measured: no run has both | | |")
        for depth, s in depths.items():
            change = f"{s['median']:+.1f} ({s['min']:+.1f} to {s['max']:+.1f})"
            lines.append(f"| {part} | {depth} | {change} | {s['helps']} of {s['runs']} | {s['hurts']} |")
    return "\n".join(lines)


def labelled(text: str) -> tuple[str, str]:
    """LABEL=MODEL, or a shipped name or weight file that is its own label."""
    label, _, model = text.rpartition("=")
    return label or Path(model).stem, model


def pair(text: str) -> tuple[Path, Path]:
    run, equals, folder = text.partition("=")
    if not equals:
        raise argparse.ArgumentTypeError(f"{text!r} is not RUN=FOLDER")
    return Path(run), Path(folder)


def measured(run: MeasuredRun, models: dict[str, str], side: int) -> Depths:
    depths: Depths = {}
    for source in depth_sources(models, side):
        start = time.monotonic()
        depths[source.name] = run.measure(source)
        shown = ", ".join(f"{name} {cell(figures)}" for name, figures in depths[source.name].items())
        print(f"{run.name}, {source.name}: {shown} ({time.monotonic() - start:.0f} s)", file=sys.stderr, flush=True)
    return depths


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("pairs", metavar="RUN=FOLDER", type=pair, nargs="+", help="finished run and its RGB-D folder")
    parser.add_argument(
        "--model", type=labelled, action="append", default=[], help="[LABEL=]shipped name or weight file; repeatable"
    )
    parser.add_argument(
        "--side", type=int, default=160, help="px, longer side of what a network of the paper's kind works on"
    )


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Run after run; the record is also written after each of them."""
    names = [run.name for run, _ in arguments.pairs]
    if len(set(names)) < len(names):
        raise SystemExit("error: two run folders have the same name")
    cv2.setNumThreads(1)
    models, runs, about, record = dict(arguments.model), {}, {}, {}
    for run, folder in arguments.pairs:
        opened = MeasuredRun(run, folder)
        about[opened.name] = opened.about
        runs[opened.name] = measured(opened, models, arguments.side)
        record = {"models": models, "side": arguments.side, "runs": runs, "about": about, "summary": summarised(runs)}
        write(arguments.json, record)
    print(table(runs, about), summary_table(record["summary"]), sep="\n\n")
    return record
