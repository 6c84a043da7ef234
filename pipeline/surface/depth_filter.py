"""Consistency of depth before fusion: neighbouring keyframes lower a keyframe's confidence, or leave it out wholly."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pipeline.config import ConsistencySettings
from pipeline.depth.completed_submap import CompletedSubmap
from reconstruction.fusion.depth_consistency import Agreement, DepthView, agreement

SEVERITY = 6.0  # one contradiction against none divides the confidence by 1 + this
MAX_CONTRADICTED = 0.5  # share of pixels beyond which a keyframe is left out
CACHED = 64  # depth maps kept while the check moves along the keyframes; more than its reach on both sides


class DepthFilter:
    """Agreement of each keyframe of a submap with keyframes before and after it."""

    def __init__(self, completed: CompletedSubmap, settings: ConsistencySettings, min_confidence: float) -> None:
        self.completed, self.settings, self.min_confidence = completed, settings, min_confidence
        self._view = lru_cache(CACHED)(self._load)

    def __call__(self, number: int) -> Agreement:
        """Of keyframe `number` among the submap's rows.

        Neighbours at growing distances: next to each other frames share points, network and errors.
        """
        neighbours = [number + sign * step for step in self.settings.steps for sign in (-1, 1)]
        others = [self._view(other) for other in neighbours if 0 <= other < len(self.completed)]
        return agreement(self._view(number), others, self.settings.tolerance)

    def confidence(self, number: int, confidence: NDArray[np.float32]) -> NDArray[np.float32] | None:
        """The keyframe's confidence times what the votes leave of it; 0 where either alone is below the least that is
        fused; None where the frame as a whole is contradicted.

        Their product is no limit: wall that a frame is half sure of would go for one contradiction of many votes.
        """
        votes = self(number)
        if votes.is_outvoted(MAX_CONTRADICTED):
            return None
        left = votes.weight(SEVERITY)
        kept = (confidence >= self.min_confidence) & (left >= self.min_confidence)
        return np.where(kept, confidence * left, np.float32(0))

    def _load(self, number: int) -> DepthView:
        depth, confidence, world_from_camera = self.completed.depth(int(self.completed.rows[number]))
        # Depth that is not sure enough to be fused has no vote, and nobody need agree with it.
        sure = np.where(confidence < self.min_confidence, np.float32(0), depth)
        return DepthView(sure, self.completed.camera.matrix, world_from_camera)
