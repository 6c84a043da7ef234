"""What true depth that is stored in coarse steps does to a judgement of depth and of predicted errors.

    python -m benchmarks.stepped_truth ../shared/data/ctcolon ../shared/data/simcol3d

The first folder's fine depth is rounded to the steps in which the second's is stored, as shares of their median depths,
then brought back by `data/quantized_depth.py`: what that is worth. The second's is judged as it is stored and
brought back likewise. Points are drawn of what is then called true, or of the depth as stored though it is judged
without its steps; the same pixels each time. SimCol3D stores 200 mm in 255 steps.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.depth_completion import judged_frames
from benchmarks.record import say, write
from completion.data.evaluation_frame import Depth, EvaluationFrame
from completion.data.quantized_depth import without_steps
from completion.data.readers import read_evaluation_frames
from completion.evaluation.accumulator import Tally
from completion.evaluation.evaluate import Protocol, evaluate_frames, mean_errors
from completion.evaluation.metrics import depth_errors
from completion.evaluation.predictors import Predictor, load_predictor

SIMCOL3D_STEP = 200 / 255  # mm
POINTS = (("uniform", 100), ("uniform", 500), ("sfm", 100), ("sfm", 500))
Depths = list[Depth]  # of the frames in order
Truths = dict[str, tuple[Depths, Depths]]  # of the points, and of the judge


def median_depth(frames: list[EvaluationFrame]) -> float:
    return float(np.median(np.concatenate([frame.depth[frame.depth > 0] for frame in frames])))


def rounded(depth: Depth, step: float) -> Depth:
    return (step * np.round(depth / step)).astype(np.float32)


def distance(fine: Depths, truths: Depths, step: float) -> dict[str, float]:
    """From the fine depth, in steps: root mean square and median over pixels nearer than a frame's median, and all."""
    near, every = [], []
    for depth, truth in zip(fine, truths, strict=True):
        known = depth > 0
        off = (np.abs(truth - depth) / step)[known]
        near.append(off[depth[known] < np.median(depth[known])])
        every.append(off)
    of_near = np.concatenate(near)
    return {"near_rms": float(np.sqrt((of_near**2).mean())), "median": float(np.median(np.concatenate(every)))}


def judged(
    predict: Predictor, frames: list[EvaluationFrame], truths: tuple[Depths, Depths], protocol: Protocol
) -> dict[str, Any]:
    of_points, of_judge = truths
    drawn_from = [replace(frame, depth=depth) for frame, depth in zip(frames, of_points, strict=True)]
    tally = Tally()
    for result, truth in zip(evaluate_frames(drawn_from, predict, protocol), of_judge, strict=True):
        tally.add(replace(result, truth=truth, errors=depth_errors(result.prediction, truth)))
    found = tally.calibration()
    assert found is not None, "the shipped model predicts its own error"
    return {
        "abs_rel_percent": 100 * mean_errors(tally.scores, protocol).abs_rel,
        "spearman": found.spearman,
        "spearman_absolute": found.spearman_absolute,
        "spearman_depth_alone": found.spearman_depth_alone,
        "within_one_percent": 100 * found.within_one,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path, help="with fine depth")
    parser.add_argument("stepped", type=Path, help="SimCol3D")
    parser.add_argument("--stride", type=int, default=4, help="every n-th frame of the first, if it has more than 20")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    predict, rows = load_predictor("mscsa"), []
    stepped = list(read_evaluation_frames(arguments.stepped))
    frames = judged_frames(arguments.folder, arguments.stride)
    step = SIMCOL3D_STEP * median_depth(frames) / median_depth(stepped)
    exact, as_stored = ([frame.depth for frame in of] for of in (frames, stepped))
    stairs = [rounded(depth, step) for depth in exact]
    there_and_back = [without_steps(depth, step) for depth in stairs]
    back = [without_steps(depth, SIMCOL3D_STEP) for depth in as_stored]
    fine: Truths = {
        "as it is": (exact, exact),
        "rounded": (stairs, stairs),
        "rounded, judged brought back": (stairs, there_and_back),
        "rounded and brought back": (there_and_back, there_and_back),
    }
    coarse: Truths = {
        "as stored": (as_stored, as_stored),
        "judged brought back": (as_stored, back),
        "brought back": (back, back),
    }
    off = {name: distance(exact, judge, step) for name, (points, judge) in fine.items() if points is judge}
    for name, figures in off.items():
        say({"truth": name, "step_mm": step} | figures)
    for sampler, points in POINTS:
        protocol = Protocol(sampler=sampler, points=points)
        for folder, of_folder, truths in ((arguments.folder, frames, fine), (arguments.stepped, stepped, coarse)):
            for name, pair in truths.items():
                row = {"folder": folder.name, "frames": len(of_folder), "sampler": sampler, "points": points}
                rows.append(row | {"truth": name} | judged(predict, of_folder, pair, protocol))
                say(rows[-1])
    write(arguments.json, {"step_mm": step, "off_in_steps": off, "rows": rows})


if __name__ == "__main__":
    main()
