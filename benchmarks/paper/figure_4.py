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
from completion.evaluation.strata import EDGE_STEP
from completion.training.config import TrainConfig

SHOWN = ("linear", "nearest", *OURS, *RIVALS)
EVERY = 8  # so many judged frames apart are those that are measured
MOST_MM = TrainConfig(shards=(), out=Path()).max_depth_mm
NEAR_PX = 4  # of an edge


def weights(work: Path, model: str, run: Run) -> Path:
    """Weight file of a run, or the name of a method without weights."""
    return Path(model) if model in UNTRAINED else work / "runs" / f"{run.name}.safetensors"


def trained(work: Path) -> dict[str, Path]:
    """The networks of Table I, seed 0, by name."""
    return {model: weights(work, model, row(model)) for model in SHOWN}


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
    measured: dict[str, dict[str, dict[str, list[float]]]] = {}
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


def figures_of(results: list[FrameResult]) -> dict[str, list[float]]:
    """Of each frame: `mesh`, `sharpness`, `roughness` and `scale`, its median ratio of completed to true depth."""
    columns: dict[str, list[float]] = {"mesh": [], "sharpness": [], "roughness": [], "scale": []}
    for result in results:
        if (edges := edge_figures(result)) is None:
            continue
        both = known(result)
        scale = float(np.median(result.prediction[both] / result.truth[both]))
        for name, value in zip(columns, (int(result.name), *edges, scale), strict=True):
            columns[name].append(round(value, 5))
    return columns


def known(result: FrameResult) -> NDArray[np.bool_]:
    """Pixels with true and completed depth."""
    return np.asarray((result.truth > 0) & (result.prediction > 0))


def edge_figures(result: FrameResult) -> tuple[float, float] | None:
    """Sharpness at the edges of the true depth and roughness away from them; None for a frame without edges.

    Steepness is the logarithm of the ratio of the largest to the smallest depth in 3x3 px. Sharpness: the greatest
    completed steepness within `NEAR_PX` of an edge over the greatest true one, so that an edge that is a little out of
    place counts as sharp; median over edges. Roughness: completed over true steepness, medians of the pixels farther
    away than that: noise raises it.
    """
    both = cv2.erode(known(result).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    truth, completed = (np.where(both, steepness(depth), 0) for depth in (result.truth, result.prediction))
    edges = truth > np.log(EDGE_STEP)
    window = np.ones((2 * NEAR_PX + 1,) * 2, np.uint8)
    smooth = both & (cv2.dilate(edges.astype(np.uint8), window) == 0)
    if not edges.any() or not smooth.any():
        return None
    sharp = cv2.dilate(completed, window)[edges] / cv2.dilate(truth, window)[edges]
    return float(np.median(sharp)), float(np.median(completed[smooth]) / np.median(truth[smooth]))


def steepness(depth: NDArray[np.floating]) -> NDArray[np.float32]:
    """Logarithm of the ratio of the largest to the smallest depth in 3x3 px, (H,W)."""
    window, logarithm = np.ones((3, 3), np.uint8), np.log(np.maximum(depth, 1e-3)).astype(np.float32)
    return np.asarray(cv2.dilate(logarithm, window) - cv2.erode(logarithm, window), np.float32)
