"""Before fusion: what a keyframe's neighbours say against its depth lowers its confidence, or leaves it out wholly."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pipeline.config import ConsistencySettings
from pipeline.dense import DenseSubmap
from reconstruction.consistency import Agreement, DepthView, agreement

CACHED = 64  # depth maps kept while the check moves along the keyframes; more than its reach on both sides


class ConsistencyCheck:
    """Agreement of each keyframe of a submap with keyframes before and after it."""

    def __init__(self, part: DenseSubmap, settings: ConsistencySettings) -> None:
        self.part, self.settings = part, settings
        self._view = lru_cache(CACHED)(self._load)

    def __call__(self, place: int) -> Agreement:
        """Of the keyframe at `place` among the part's rows.

        Neighbours at growing distances: next to each other frames share points, network and errors.
        """
        places = [place + sign * step for step in self.settings.steps for sign in (-1, 1)]
        others = [self._view(other) for other in places if 0 <= other < len(self.part)]
        return agreement(self._view(place), others, self.settings.tolerance)

    def confidence(self, place: int, confidence: NDArray[np.float32]) -> NDArray[np.float32] | None:
        """The keyframe's confidence lowered where it is contradicted; None where the frame as a whole is."""
        votes = self(place)
        if votes.contradicted_share > self.settings.max_contradicted:
            return None
        return confidence * votes.weight(self.settings.severity)

    def _load(self, place: int) -> DepthView:
        keyframe = self.part.keyframe(int(self.part.rows[place]))
        return DepthView(keyframe.depth, self.part.camera.matrix, keyframe.world_from_camera)
