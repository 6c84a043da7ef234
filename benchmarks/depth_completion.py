"""abs.REL of the shipped model beside linear interpolation on folders with true depth.

    python benchmarks/depth_completion.py ../shared/data/ctcolon ../shared/data/simcol3d --json completion.json

Samplers: `uniform` takes pixels at random with true depth. `sfm` takes SIFT keypoints (OpenCV, contrast threshold
0.005) at random, multiplies depth by 1 + 0.03 N(0,1), 3 % of the points by U(0.5, 2), and all points of a frame by
one unknown factor in [e^-2, e^2]. Per frame: mean |p - g| / g over valid pixels, the prediction divided by the known
factor; then the mean over frames. Linear interpolation fills outside the hull with the nearest point.
"""

import argparse
from pathlib import Path

import numpy as np

from completion import DepthCompleter
from completion.classical import linear
from completion.frames import EvaluationFrame
from completion.infer import load_scale_free
from completion.metrics import depth_errors
from completion.readers import read_evaluation_frames
from completion.sparsify import get_sampler
from record import say, write

SETTINGS = (("uniform", 100), ("sfm", 100), ("sfm", 500))


def absolute_relative(depth: np.ndarray, truth: np.ndarray) -> float:
    return 100 * depth_errors(depth, truth).abs_rel


def judged_frames(folder: Path, stride: int) -> list[EvaluationFrame]:
    """All frames of a short sequence, every `stride`-th of a long one."""
    frames = list(read_evaluation_frames(folder))
    return frames if len(frames) <= 20 else frames[::stride]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--model", default="mscsa")
    parser.add_argument(
        "--looks", type=int, help="how often each frame is completed; the model's own number if not given"
    )
    parser.add_argument("--stride", type=int, default=4, help="every n-th frame of a long sequence")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    completer = DepthCompleter(load_scale_free(arguments.model), looks=arguments.looks)
    rows = []
    for folder in arguments.folders:
        frames = judged_frames(folder, arguments.stride)
        for sampler, points in SETTINGS:
            rng = np.random.default_rng(0)
            errors = {"linear": [], arguments.model: []}
            for frame in frames:
                points_of = get_sampler(sampler)(frame.rgb, frame.depth, points, rng)
                sparse, factor = points_of.depth, points_of.factor
                errors["linear"].append(absolute_relative(linear(sparse) / factor, frame.depth))
                errors[arguments.model].append(absolute_relative(completer(frame.rgb, sparse)[0] / factor, frame.depth))
            row = {"folder": folder.name, "sampler": sampler, "points": points, "frames": len(frames)}
            row |= {f"{name}_abs_rel_percent": float(np.mean(values)) for name, values in errors.items()}
            rows.append(row)
            say(row)
    write(arguments.json, {"looks": completer.looks, "working_side": completer.working_side, "rows": rows})


if __name__ == "__main__":
    main()
