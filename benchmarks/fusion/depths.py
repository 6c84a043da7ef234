"""Depths that one run's keyframes can be fused with: interpolated, completed by any network, true.

Depth is (H,W) float32, z in scene units, 0 = none, in the keyframe's rectified picture; confidence (H,W) in [0,1], or
None where the method gives none. Every depth is cut to the pixels where the run itself has one, so that none is judged
on a border that another did not see.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator

from completion import DepthCompleter
from completion.evaluation.predictors import Predictor, load_predictor
from completion.networks.protocol import DepthNetwork
from pipeline.depth.completed_submap import CompletedKeyframe
from pipeline.depth.rectification import Rectifier
from pipeline.depth.sparse_depth import SparseDepth

Depth = NDArray[np.float32]
Completed = tuple[Depth, Depth | None]


@dataclass(frozen=True)
class KeyframeView:
    """A keyframe as the depth stage left it, the sparse points it was completed from, and its picture's true depth."""

    keyframe: CompletedKeyframe
    sparse: SparseDepth
    rectifier: Rectifier
    mm_per_unit: float  # the true scale of its submap's path
    true_depth: Path | None  # PNG in the unrectified picture; None where the truth does not know the frame
    true_unit: float  # mm for one count of that PNG


Complete = Callable[[KeyframeView], Completed]


@dataclass(frozen=True)
class DepthSource:
    """`complete` makes a view's depth: in scene units of the map before refinement, or if `is_true` in mm.

    The former is multiplied by a keyframe's scale where the pose graph moved it, as the run's own depth is; the
    latter is divided by the scale of whichever path it is fused along.
    """

    name: str
    complete: Complete
    is_true: bool = False


def depth_sources(models: dict[str, str], side: int) -> list[DepthSource]:
    """Linear interpolation, each of `models` (label: shipped name or weight file), the run's own depth, true depth."""
    named = {label: model_depth(model, side) for label, model in models.items()}
    sources = {"linear": linear_depth, **named, "the run's own": own_depth}
    return [*(DepthSource(name, complete) for name, complete in sources.items()), DepthSource("true", true_depth, True)]


def linear_depth(view: KeyframeView) -> Completed:
    """Delaunay triangles of the sparse points, z linear in each; nothing outside their hull."""
    rows, columns = np.indices(view.keyframe.depth.shape) + 0.5
    depth = LinearNDInterpolator(view.sparse.pixels, view.sparse.depth, fill_value=0)(columns, rows)
    return depth.astype(np.float32), None


def own_depth(view: KeyframeView) -> Completed:
    """What the run wrote."""
    return view.keyframe.depth, view.keyframe.confidence


def true_depth(view: KeyframeView) -> Completed:
    """In mm, brought to the rectified picture by the nearest pixel: z is the same along a ray of either lens."""
    shape = view.keyframe.depth.shape
    if view.true_depth is None:
        return np.zeros(shape, np.float32), None
    image = cv2.imread(str(view.true_depth), cv2.IMREAD_UNCHANGED)
    if image is None or image.dtype != np.uint16 or image.shape != shape:
        raise SystemExit(f"error: {view.true_depth} is no 16-bit depth of the run's picture size {shape}")
    return view.rectifier.mask(image).astype(np.float32) * np.float32(view.true_unit), None


def model_depth(model: str, side: int) -> Complete:
    """What a shipped model or a weight file makes of the run's sparse points.

    Ours takes them as they are. A network of the paper's kind expects metric depth, which no run has: it is given the
    points times the true scale of the path, as the paper assumes, and its answer is divided by it again. It has no
    confidence. `side`: px, longer side of the picture that it works on.
    """
    predictor = load_predictor(model)
    if not isinstance(predictor.network, DepthNetwork):
        return _metric_depth(predictor, side)
    completer = DepthCompleter.load(model)

    def complete(view: KeyframeView) -> Completed:
        return completer(view.keyframe.rgb, *view.sparse.maps(*view.keyframe.depth.shape))

    return complete


def _metric_depth(predictor: Predictor, side: int) -> Complete:
    def complete(view: KeyframeView) -> Completed:
        height, width = view.keyframe.depth.shape
        share = min(1.0, side / max(height, width))
        size = round(width * share), round(height * share)
        shrink = np.array(size) / (width, height)  # of x and y
        sparse = SparseDepth(view.sparse.pixels * shrink, view.sparse.depth * view.mm_per_unit, view.sparse.error)
        rgb = cv2.resize(view.keyframe.rgb, size, interpolation=cv2.INTER_AREA)
        lens = np.array(view.rectifier.camera.params[:4]) * np.tile(shrink, 2)
        depth, _ = predictor(rgb, sparse.maps(size[1], size[0])[0], lens)
        return cv2.resize(depth, (width, height)) / np.float32(view.mm_per_unit), None

    return complete


def completed(source: DepthSource, view: KeyframeView) -> Completed:
    """A source's depth where the run has one, not negative and finite."""
    depth, confidence = source.complete(view)
    kept = (view.keyframe.depth > 0) & np.isfinite(depth) & (depth > 0)
    return np.where(kept, depth, np.float32(0)), confidence
