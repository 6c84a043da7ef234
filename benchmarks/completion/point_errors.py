"""What the errors of SfM-like points cost the shipped model: abs.REL as they are, and with parts of them taken out.

    python -m benchmarks.completion point-errors CTCOLON SIMCOL3D --points 500 --json errors.json

Points and figure of `completion accuracy`'s sfm rows (`--stride 4 --draws 1`), in percent, means over frames. An
outlier is a point further from the truth than four times the sampler's noise. "told" keeps every error but says how
large it is: noise as the sampler draws it, half the depth at an outlier; "noise_told" says the noise of all alike. The
paired standard error is over frames, of one sequence all. "within": share of pixels whose relative error is below the
predicted one, 63 % if that is calibrated.
"""

import argparse
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.record import print_row
from benchmarks.common.runner import add_folders
from benchmarks.completion.accuracy import absolute_relative, judged_frames
from completion import DepthCompleter
from completion.confidence import error_from_confidence
from completion.data.evaluation_frame import EvaluationFrame
from completion.data.sampling_benchmark import NOISE, like_sfm

OUTLIER_ERROR = 0.5  # relative error told of an outlier
Case = tuple[NDArray[np.float32], NDArray[np.float32] | None]  # sparse depth in the truth's unit, error that is told


def cases(sparse: NDArray[np.float32], truth: NDArray[np.float32]) -> dict[str, Case]:
    """Points (H,W) with errors and true depth (H,W) -> the same points with parts of their errors."""
    exact = np.where(sparse > 0, truth, 0).astype(np.float32)
    outlier = np.abs(sparse - exact) > 4 * NOISE * exact
    told = np.where(outlier, OUTLIER_ERROR, NOISE).astype(np.float32)
    return {
        "as_drawn": (sparse, None),
        "told": (sparse, told),
        "noise_told": (sparse, np.full_like(sparse, NOISE)),
        "no_outliers": (np.where(outlier, exact, sparse), None),
        "no_noise": (np.where(outlier, sparse, exact), None),
        "exact": (exact, None),
    }


def rows_of(completer: DepthCompleter, frames: list[EvaluationFrame], points: int) -> list[dict[str, Any]]:
    """A row for each case, over the same points of the same frames."""
    rng = np.random.default_rng(0)
    errors: dict[str, list[float]] = {}
    within: dict[str, list[float]] = {}
    for frame in frames:
        drawn = like_sfm(frame.rgb, frame.depth, points, rng)
        known = frame.depth > 0
        for name, (sparse, told) in cases(drawn.depth / drawn.factor, frame.depth).items():
            made, confidence = completer(frame.rgb, sparse, told)
            off = np.abs(made[known] / frame.depth[known] - 1)
            within.setdefault(name, []).append(np.mean(off < error_from_confidence(confidence[known])))
            errors.setdefault(name, []).append(absolute_relative(made, frame.depth))
    rows = []
    for name, values in errors.items():
        paired = np.std(np.subtract(values, errors["as_drawn"]), ddof=1) / np.sqrt(len(values))
        row = {"points": points, "frames": len(values), "case": name}
        row |= {"abs_rel_percent": float(np.mean(values)), "paired_error": float(paired)}
        rows.append(row | {"within_percent": 100 * float(np.mean(within[name]))})
    return rows


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser, "with true depth")
    parser.add_argument("--points", type=int, default=500)
    parser.add_argument("--model", default="mscsa")
    parser.add_argument("--stride", type=int, default=4, help="every n-th frame of a long sequence")


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Every folder with every case."""
    completer, rows = DepthCompleter.load(arguments.model), []
    for folder in arguments.folders:
        for row in rows_of(completer, judged_frames(folder, arguments.stride), arguments.points):
            rows.append({"folder": folder.name} | row)
            print_row(rows[-1])
    return {"iterations": completer.iterations, "precision": completer.precision, "rows": rows}
