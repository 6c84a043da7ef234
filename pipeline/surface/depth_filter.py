"""What of a keyframe's depth is fused: neighbouring keyframes lower its confidence, or leave it out wholly, and depth
whose expected error would blur the surface stays out."""

from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from completion.confidence import error_from_confidence
from pipeline.config import ConsistencySettings
from pipeline.depth.completed_submap import CompletedSubmap
from reconstruction.fusion.depth_consistency import Agreement, DepthView, agreement

SEVERITY = 6.0  # one contradiction against none divides the confidence by 1 + this
MAX_CONTRADICTED = 0.5  # share of pixels beyond which a keyframe is left out
LEAST_CONFIDENCE = 1e-6  # whose error is 30 times the depth: finite, and never fused
CACHED = 64  # depth maps kept while the check moves along the keyframes; more than its reach on both sides


class DepthFilter:
    """Agreement of each keyframe of a submap with keyframes before and after it, and what that leaves to be fused.

    max_error: scene units, greatest expected error of a depth that is fused. It takes the place of a greatest
    depth: far wall enters where it is sure.
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
        # Of no method, which would hold this object, and it the views, until Python looks for cycles.
        self._view = lru_cache(CACHED)(partial(_view_of, completed, min_confidence))

    def __call__(self, number: int) -> Agreement:
        """Of keyframe `number` among the submap's rows.

        Neighbours at growing distances: next to each other frames share points, network and errors.
        """
        neighbours = [number + sign * step for step in self.settings.steps for sign in (-1, 1)]
        others = [self._view(other) for other in neighbours if 0 <= other < len(self.completed)]
        return agreement(self._view(number), others, self.settings.tolerance)

    def confidence(self, number: int, confidence: NDArray[np.float32]) -> NDArray[np.float32] | None:
        """What is left of the keyframe's confidence (H,W), as `admitted_confidence` has it."""
        depth, limits = self._view(number).depth, (self.min_confidence, self.max_error)
        return admitted_confidence(confidence, depth, self(number), *limits)


def admitted_confidence(
    confidence: NDArray[np.float32],
    depth: NDArray[np.float32],
    votes: Agreement,
    min_confidence: float,
    max_error: float,
) -> NDArray[np.float32] | None:
    """Confidence (H,W) of a frame's depth (H,W) times what the votes leave of it; 0 where either alone is below the
    least that is fused, or the error that the product stands for is over the greatest, in the depth's unit; None where
    the frame as a whole is contradicted.

    The least confidence is no limit of the product: wall that a frame is half sure of would go for one contradiction of
    many votes.
    """
    if votes.is_outvoted(MAX_CONTRADICTED):
        return None
    left = votes.weight(SEVERITY)
    kept = (confidence >= min_confidence) & (left >= min_confidence)
    remaining = np.where(kept, confidence * left, np.float32(0))
    if np.isfinite(max_error):
        remaining[error_from_confidence(remaining, LEAST_CONFIDENCE) * depth > max_error] = 0
    return remaining


def _view_of(completed: CompletedSubmap, min_confidence: float, number: int) -> DepthView:
    depth, confidence, world_from_camera = completed.depth(int(completed.rows[number]))
    # Depth that is not sure enough to be fused has no vote, and nobody need agree with it.
    sure = np.where(confidence < min_confidence, np.float32(0), depth)
    return DepthView(sure, completed.camera.matrix, world_from_camera)
