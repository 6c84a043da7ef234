"""What the errors of SfM-like points cost the shipped model: abs.REL as they are, and with parts of them taken out.

    python -m benchmarks.point_errors ../shared/data/ctcolon ../shared/data/simcol3d --points 500 --json errors.json

Points and figure of `depth_completion.py`'s sfm rows (`--stride 4 --draws 1`), in percent, means over frames. An
outlier is a point further from the truth than four times the sampler's noise. "told" keeps every error but says how
large it is: noise as the sampler draws it, half the depth at an outlier; "noise_told" says the noise of all alike. The
paired standard error is over frames, of one sequence all. "within": share of pixels whose relative error is below the
predicted one, 63 % if that is calibrated.
"""

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.depth_completion import absolute_relative, judged_frames
from benchmarks.record import say, write
from completion import DepthCompleter
from completion.confidence import error_from_confidence
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--points", type=int, default=500)
    parser.add_argument("--model", default="mscsa")
    parser.add_argument("--stride", type=int, default=4, help="every n-th frame of a long sequence")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    completer, rows = DepthCompleter.load(arguments.model), []
    for folder in arguments.folders:
        frames = judged_frames(folder, arguments.stride)
        rng, errors, within = np.random.default_rng(0), {}, {}
        for frame in frames:
            points_of = like_sfm(frame.rgb, frame.depth, arguments.points, rng)
            for name, (sparse, told) in cases(points_of.depth / points_of.factor, frame.depth).items():
                made, confidence = completer(frame.rgb, sparse, told)
                known = frame.depth > 0
                off = np.abs(made[known] / frame.depth[known] - 1)
                within.setdefault(name, []).append(np.mean(off < error_from_confidence(confidence[known])))
                errors.setdefault(name, []).append(absolute_relative(made, frame.depth))
        for name, values in errors.items():
            paired = np.std(np.subtract(values, errors["as_drawn"]), ddof=1) / np.sqrt(len(values))
            row = {"folder": folder.name, "points": arguments.points, "frames": len(values), "case": name}
            rows.append(row | {"abs_rel_percent": float(np.mean(values)), "paired_error": float(paired)})
            rows[-1]["within_percent"] = 100 * float(np.mean(within[name]))
            say(rows[-1])
    write(arguments.json, {"looks": completer.looks, "precision": completer.precision, "rows": rows})


if __name__ == "__main__":
    main()
