"""abs.REL of the shipped model beside linear interpolation on folders with true depth.

    python -m benchmarks.completion accuracy ../shared/data/ctcolon ../shared/data/simcol3d --json completion.json

Samplers: `uniform` takes pixels at random with true depth. `sfm` takes SIFT keypoints (OpenCV, contrast threshold
0.005) at random, multiplies depth by 1 + 0.03 N(0,1), 3 % of the points by U(0.5, 2), and all points of a frame by
one unknown factor in [e^-2, e^2]. Per frame: mean |p - g| / g over valid pixels, the prediction divided by the known
factor; then the mean over frames, and over `--draws` draws of points, whose least and most are given too. Beside it the
median over all frames and draws, and the share of them over 10 %. Linear interpolation fills outside the hull with the
nearest point.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common.record import print_row
from benchmarks.common.runner import add_folders
from completion import DepthCompleter
from completion.data.evaluation_frame import EvaluationFrame
from completion.data.readers import read_evaluation_frames
from completion.data.sampling_benchmark import get_sampler
from completion.evaluation.metrics import depth_errors
from completion.inference.completer import load_depth_network
from completion.networks.classical import linear

SETTINGS = (("uniform", 100), ("sfm", 100), ("sfm", 500))


def absolute_relative(depth: np.ndarray, truth: np.ndarray) -> float:
    return 100 * depth_errors(depth, truth).abs_rel


def judged_frames(folder: Path, stride: int) -> list[EvaluationFrame]:
    """All frames of a short sequence, every `stride`-th of a long one."""
    frames = list(read_evaluation_frames(folder))
    return frames if len(frames) <= 20 else frames[::stride]


def errors_of(
    completer: DepthCompleter, frames: list[EvaluationFrame], sampler: str, points: int, seed: int
) -> np.ndarray:
    """abs.REL (F,2) in percent of linear interpolation and of the model, from one draw of points in each frame."""
    rng, errors = np.random.default_rng(seed), []
    for frame in frames:
        drawn = get_sampler(sampler)(frame.rgb, frame.depth, points, rng)
        made = linear(drawn.depth), completer(frame.rgb, drawn.depth)[0]
        errors.append([absolute_relative(depth / drawn.factor, frame.depth) for depth in made])
    return np.array(errors)


def row_of(
    completer: DepthCompleter, model: str, frames: list[EvaluationFrame], sampler: str, points: int, draws: int
) -> dict[str, Any]:
    """Mean abs.REL of both over the draws, the least and most of a draw, the median frame and the frames over 10 %."""
    errors = [errors_of(completer, frames, sampler, points, seed) for seed in range(draws)]
    row: dict[str, Any] = {"sampler": sampler, "points": points, "frames": len(frames)}
    for place, name in enumerate(("linear", model)):
        of_frames = np.array(errors)[..., place]
        of_draws = of_frames.mean(axis=1).tolist()
        row[f"{name}_abs_rel_percent"] = float(np.mean(of_draws))
        row |= {f"{name}_least": min(of_draws), f"{name}_most": max(of_draws)}
        row |= {f"{name}_median": float(np.median(of_frames)), f"{name}_over_10": float(100 * (of_frames > 10).mean())}
    return row


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser, "with true depth")
    parser.add_argument("--model", default="mscsa")
    parser.add_argument(
        "--iterations",
        "--looks",
        type=int,
        help="of the network for a frame; as many as the model's default if not given",
    )
    parser.add_argument("--stride", type=int, default=1, help="every n-th frame of a sequence of more than 20")
    parser.add_argument("--draws", type=int, default=4, help="of points, by seeds from 0 on")


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Every folder with every setting of the points."""
    completer = DepthCompleter(load_depth_network(arguments.model), iterations=arguments.iterations)
    rows = []
    for folder in arguments.folders:
        frames = judged_frames(folder, arguments.stride)
        for sampler, points in SETTINGS:
            row = row_of(completer, arguments.model, frames, sampler, points, arguments.draws)
            rows.append({"folder": folder.name} | row)
            print_row(rows[-1])
    about = {"iterations": completer.iterations, "precision": completer.precision, "draws": arguments.draws}
    return about | {"rows": rows}
