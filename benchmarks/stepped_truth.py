"""What true depth that is stored in coarse steps does to a judgement of predicted errors.

    python benchmarks/stepped_truth.py ../shared/data/ctcolon ../shared/data/simcol3d

The first folder's true depth is rounded to the steps in which the second's is stored, as shares of their median
depths; points are drawn of what is then called true. Both judgements are of the same model and the same pixels.
SimCol3D stores 200 mm in 255 steps.
"""

import argparse
from pathlib import Path

import numpy as np

from completion import DepthCompleter
from completion.calibration import Calibration, calibrate, pixel_errors
from completion.confidence import error_from_confidence
from completion.frames import EvaluationFrame
from completion.readers import read_evaluation_frames
from completion.sparsify import get_sampler
from depth_completion import judged_frames
from record import say, write

SIMCOL3D_STEP = 200 / 255  # mm
POINTS = (("uniform", 100), ("uniform", 500))


def median_depth(frames: list[EvaluationFrame]) -> float:
    return float(np.median(np.concatenate([frame.depth[frame.depth > 0] for frame in frames])))


def judged(
    completer: DepthCompleter, frames: list[EvaluationFrame], sampler: str, points: int, step: float
) -> Calibration:
    """Against depth in steps of `step` mm; 0 for depth as it is."""
    rng, pixels = np.random.default_rng(0), []
    for frame in frames:
        truth = frame.depth if not step else (step * np.round(frame.depth / step)).astype(np.float32)
        drawn = get_sampler(sampler)(frame.rgb, truth, points, rng)
        depth, confidence = completer(frame.rgb, drawn.depth)
        pixels.append(pixel_errors(depth, truth, error_from_confidence(confidence)))
    return calibrate(pixels)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path, help="with fine depth")
    parser.add_argument("stepped", type=Path, help="SimCol3D")
    parser.add_argument("--stride", type=int, default=4, help="every n-th frame of the first, if it has more than 20")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    completer, rows = DepthCompleter.load("mscsa"), []
    stepped = list(read_evaluation_frames(arguments.stepped))
    frames = judged_frames(arguments.folder, arguments.stride)
    step = SIMCOL3D_STEP * median_depth(frames) / median_depth(stepped)
    for sampler, points in POINTS:
        for of_step in (0.0, step):
            found = judged(completer, frames, sampler, points, of_step)
            row = {"folder": arguments.folder.name, "frames": len(frames), "sampler": sampler, "points": points}
            row |= {"step_mm": of_step, "spearman": found.spearman, "spearman_absolute": found.spearman_absolute}
            rows.append(row | {"within_one_percent": 100 * found.within_one})
            say(rows[-1])
    write(arguments.json, {"rows": rows})


if __name__ == "__main__":
    main()
