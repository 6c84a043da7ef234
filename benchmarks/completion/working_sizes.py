"""abs.REL of a completion model by the size it works at and its number of iterations, on rendered frames.

    haustra phantom E --training 160 --size 480 --seed 750000
    python -m benchmarks.completion working-sizes E --size 320 --size 448 --iterations 1 --iterations 2 --json f.json
    python -m benchmarks.completion working-sizes E --picture 320 --size 320 --size 448   # frames of 320 px
    python -m benchmarks.completion working-sizes E --precision bf16 --precision int8

Every `--stride`-th frame, points of `haustra evaluate`'s samplers, seeded by the frame, the same for every row; a size
of 0 is the one that `DepthCompleter` chooses. Means over the frames, in percent, and the standard error of the paired
difference from the first row, over frames, of which several may show one mesh. None of these points says how wrong it
is, as those of a run do: `benchmarks.fusion` measures what that is worth.
"""

import argparse
from itertools import product
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.common.record import print_row
from benchmarks.common.runner import add_folder
from completion import DepthCompleter
from completion.data.sampling_benchmark import get_sampler
from completion.data.shards import Shard
from completion.evaluation.metrics import depth_errors
from completion.inference.completer import load_depth_network

POINTS = (("sfm", 30), ("uniform", 100), ("sfm", 100), ("sfm", 500), ("sfm", 1500), ("features", 1000))
MAX_DEPTH, FEWEST = 250.0, 15  # mm; points under which a frame is left out
Variant = tuple[str, int, int, str]  # model, size in px, iterations, precision
Frame = tuple[int, np.ndarray, np.ndarray]  # number, rgb (H,W,3), depth (H,W) mm


def frames_of(folder: Path, stride: int, picture: int | None) -> list[Frame]:
    """Every `stride`-th frame, at `picture` px."""
    shard, frames = Shard.open(folder), []
    for index in range(0, len(shard.images), stride):
        rgb, depth = np.ascontiguousarray(shard.images[index]), shard.depths[index].astype(np.float32)
        depth[depth > MAX_DEPTH] = 0
        if picture:
            rgb = cv2.resize(rgb, (picture, picture), interpolation=cv2.INTER_AREA)
            depth = cv2.resize(depth, (picture, picture), interpolation=cv2.INTER_NEAREST_EXACT)
        frames.append((index, rgb, depth))
    return frames


def completers_of(arguments: argparse.Namespace) -> dict[Variant, DepthCompleter]:
    """Every combination that is asked for."""
    sizes, iterations = arguments.size or [320], arguments.iterations or [2]
    variants = product(arguments.model or ["mscsa"], sizes, iterations, arguments.precision or ["auto"])
    return {
        (model, size, count, precision): DepthCompleter(
            load_depth_network(model), precision=precision, resolution=size or None, iterations=count
        )
        for model, size, count, precision in variants
    }


def errors_of(
    completers: dict[Variant, DepthCompleter], frames: list[Frame], sampler: str, points: int
) -> dict[Variant, list[float]]:
    """abs.REL in percent of each frame that has points enough, all of the same points."""
    errors: dict[Variant, list[float]] = {variant: [] for variant in completers}
    for index, rgb, depth in frames:
        sparse = get_sampler(sampler)(rgb, depth, points, np.random.default_rng([0, index]))
        if sparse.points < FEWEST:
            continue
        for variant, completer in completers.items():
            made = (completer(rgb, sparse.depth)[0] / sparse.factor).astype(np.float32)
            errors[variant].append(100 * depth_errors(made, depth).abs_rel)
    return errors


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folder(parser, "training shards that nothing was trained on")
    parser.add_argument("--model", action="append")
    parser.add_argument("--size", action="append", type=int, help="px")
    parser.add_argument("--iterations", "--looks", action="append", type=int)
    parser.add_argument("--precision", action="append", help="int8, bf16 or fp32")
    parser.add_argument("--picture", type=int, help="px to which the frames are reduced first")
    parser.add_argument("--stride", type=int, default=4, help="every n-th frame")


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Every setting of the points by every variant of the model."""
    frames, completers = frames_of(arguments.folder, arguments.stride, arguments.picture), completers_of(arguments)
    rows = []
    for sampler, points in POINTS:
        errors = errors_of(completers, frames, sampler, points)
        first = np.array(next(iter(errors.values())))
        if len(first) < 2:
            continue
        for (model, size, iterations, precision), values in errors.items():
            paired = float(np.std(np.array(values) - first, ddof=1) / np.sqrt(len(values)))
            row = {"sampler": sampler, "points": points, "frames": len(values), "model": model, "size_px": size}
            row |= {"iterations": iterations, "precision": precision, "abs_rel_percent": float(np.mean(values))}
            rows.append(row | {"paired_error": paired})
            print_row(rows[-1], digits=3)
    return {"rows": rows}
