"""Which depth of a keyframe is fused, and with what confidence.

Keyframes around it vote on its pixels: contradictions lower the confidence, and too many leave the whole keyframe out.
Depth whose expected error would blur the surface stays out, too. `depth_frame.prepare_frame` weighs by what is left.
"""

from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from completion.confidence import error_from_confidence
from pipeline.config import ConsistencySettings
from pipeline.depth.completed_submap import CompletedSubmap
from reconstruction.fusion.depth_consistency import Agreement, DepthView, agreement

SEVERITY = 6.0  # one contradiction without any support divides the confidence by 1 + this
MAX_CONTRADICTED = 0.5  # share of pixels beyond which a keyframe is left out
LEAST_CONFIDENCE = 1e-6  # whose error is 30 times the depth: finite, and never fused
CACHED = 64  # depth maps kept while the check moves along the keyframes; more than its reach on both sides


class DepthFilter:
    """Agreement of each keyframe of a submap with keyframes before and after it, and the confidence that this leaves.

    min_confidence: of depth that is fused, and that has a vote. max_error: scene units, greatest expected error of a
    depth that is fused. It takes the place of a greatest depth: far wall enters where it is sure.
    """

    def __init__(
        self,
        completed: CompletedSubmap,
        settings: ConsistencySettings,
        min_confidence: float,
        max_error: float = np.inf,
    ) -> None:
        self.completed, self.settings, self.min_confidence = completed, settings, min_confidence
        self.max_error = max_error
        # A cached method would hold this object, and it the cache with its depth maps, until garbage collection.
        self._view = lru_cache(CACHED)(partial(_view_of, completed, min_confidence))

    def __call__(self, number: int) -> Agreement:
        """Votes on keyframe `number`, a place in `completed.rows`.

        Its neighbours stand at growing distances (`steps`), since adjacent keyframes share points and so errors.
        """
        neighbours = [number + sign * step for step in self.settings.steps for sign in (-1, 1)]
        others = [self._view(other) for other in neighbours if 0 <= other < len(self.completed)]
        return agreement(self._view(number), others, self.settings.tolerance)

    def confidence(self, number: int, confidence: NDArray[np.float32]) -> NDArray[np.float32] | None:
        """Confidence (H,W) with which the keyframe's depth is fused, as of `admitted_confidence`."""
        depth, limits = self._view(number).depth, (self.min_confidence, self.max_error)
        return admitted_confidence(confidence, depth, self(number), *limits)


def admitted_confidence(
    confidence: NDArray[np.float32],
    depth: NDArray[np.float32],
    votes: Agreement,
    min_confidence: float,
    max_error: float,
) -> NDArray[np.float32] | None:
    """Confidence (H,W) times the votes' factor on it (H,W); None where the votes contradict the frame as a whole.

    It is 0 where confidence or factor is below `min_confidence`, or where the expected error of the product, relative
    error times depth (H,W), is over `max_error`, in the depth's unit. `min_confidence` is no limit of the product: wall
    that a frame is half sure of would go for one contradiction among many votes.
    """
    if votes.is_outvoted(MAX_CONTRADICTED):
        return None
    factor = votes.confidence_factor(SEVERITY)
    kept = (confidence >= min_confidence) & (factor >= min_confidence)
    admitted = np.where(kept, confidence * factor, np.float32(0))
    if np.isfinite(max_error):
        admitted[error_from_confidence(admitted, LEAST_CONFIDENCE) * depth > max_error] = 0
    return admitted


def _view_of(completed: CompletedSubmap, min_confidence: float, number: int) -> DepthView:
    depth, confidence, world_from_camera = completed.depth(int(completed.rows[number]))
    # Depth that is not sure enough to be fused has no vote, and nobody need agree with it.
    sure = np.where(confidence < min_confidence, np.float32(0), depth)
    return DepthView(sure, completed.camera.matrix, world_from_camera)
