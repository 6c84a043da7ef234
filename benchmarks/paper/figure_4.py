"""The paper's Figure 4: all networks on one frame of each scene, and what is said of such pictures as figures.

The frames are the middle ones of each scene's judged frames: nobody chose them by what they show. The figures are of
every `EVERY`-th judged frame.
"""

from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.paper.claims import SCENE_NAMES
from benchmarks.paper.frames import judged_frames, plans
from benchmarks.paper.judgements import NAMES, row
from benchmarks.paper.plan import JUDGED_FRAMES, OURS, POINTS, RIVALS, UNTRAINED, Run
from completion.data.evaluation_frame import EvaluationFrame
from completion.evaluation.evaluate import FrameResult, Protocol, evaluate_frames
from completion.evaluation.plots import comparison_plot
from completion.evaluation.predictors import Predictor, load_predictor
from completion.training.config import TrainConfig

SHOWN = ("linear", "nearest", *OURS, *RIVALS)  # what is trained of them
EVERY = 8
MOST_MM = TrainConfig(shards=(), out=Path()).max_depth_mm
STEP = 1.1  # ratio of the largest to the smallest true depth in 3x3 px that is an edge, as in `strata`


def weights(work: Path, model: str, run: Run) -> Path:
    """Weight file of a run, or the name of a method without weights."""
    return Path(model) if model in UNTRAINED else work / "runs" / f"{run.name}.safetensors"


def trained(work: Path) -> dict[str, Path]:
    """The networks of Table I that are there, seed 0, by name."""
    paths = {model: weights(work, model, row(model)) for model in SHOWN}
    return {model: path for model, path in paths.items() if model in UNTRAINED or path.exists()}


def frames_of(work: Path, scene: str, start: int, step: int | None = None) -> list[EvaluationFrame]:
    """Judged frames of a scene from a place on: every `step`-th, or one."""
    end = None if step else start + 1
    return list(islice(judged_frames(plans(work, scene)[1].folder, MOST_MM), start, end, step))


def completed(predictor: Predictor, frames: list[EvaluationFrame]) -> list[FrameResult]:
    """What a network makes of frames."""
    return list(evaluate_frames(frames, predictor, Protocol(points=POINTS)))


def draw(work: Path, picture: Path) -> dict[str, Any]:
    """Draw all networks on the four scenes; returns abs.REL of each picture, a fraction, and `figures_of` each."""
    names = NAMES | {"linear": "linear interpolation", "nearest": "nearest point"}
    shown: dict[str, list[FrameResult]] = {}
    measured: dict[str, dict[str, dict[str, float]]] = {}
    for model, path in trained(work).items():
        predictor = load_predictor(path)
        shown[model] = [
            replace(completed(predictor, frames_of(work, scene, JUDGED_FRAMES // 2))[0], name=name)
            for scene, name in SCENE_NAMES.items()
        ]
        measured[model] = {
            scene: figures_of(completed(predictor, frames_of(work, scene, 0, EVERY))) for scene in SCENE_NAMES
        }
    titled = {names[model].replace(", ", ",\n"): results for model, results in shown.items()}
    comparison_plot(picture, titled, f"{POINTS} uniform points, 160 px, one network for four scenes")
    errors = {model: {r.name: round(r.errors.abs_rel, 5) for r in of} for model, of in shown.items()}
    return {"abs_rel": errors, "measured": measured}


def figures_of(results: list[FrameResult]) -> dict[str, float]:
    """`sharpness`: at edges of the truth, the logarithm of the ratio of the largest to the smallest completed depth in
    3x3 px over that of the true ones: 1 if an edge is as steep as it is, less if it is blurred; median over frames.
    `scale`: median over frames of a frame's median ratio of completed to true depth; the 10th and 90th percentile."""
    scales = [float(np.median(r.prediction[k] / r.truth[k])) for r in results if (k := known(r)).any()]
    low, middle, high = np.percentile(scales, [10, 50, 90])
    edges = [sharp for r in results if (sharp := sharpness(r)) is not None]
    figures = {"sharpness": float(np.median(edges)), "scale": middle, "scale_low": low, "scale_high": high}
    return {name: round(float(value), 5) for name, value in figures.items()}


def known(result: FrameResult) -> NDArray[np.bool_]:
    """Pixels with true and completed depth."""
    return np.asarray((result.truth > 0) & (result.prediction > 0))


def sharpness(result: FrameResult) -> float | None:
    """Median over the frame's edges; None where it has none."""
    both = cv2.erode(known(result).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    steps = [steepness(depth) for depth in (result.truth, result.prediction)]
    edges = both & (steps[0] > np.log(STEP))
    return float(np.median(steps[1][edges] / steps[0][edges])) if edges.any() else None


def steepness(depth: NDArray[np.floating]) -> NDArray[np.float32]:
    """Logarithm of the ratio of the largest to the smallest depth in 3x3 px, (H,W)."""
    window, logarithm = np.ones((3, 3), np.uint8), np.log(np.maximum(depth, 1e-3)).astype(np.float32)
    return np.asarray(cv2.dilate(logarithm, window) - cv2.erode(logarithm, window), np.float32)
