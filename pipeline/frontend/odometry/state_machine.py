"""Odometry as a state machine (starting, tracking, lost): frames go in one by one, local maps come out.

A lost camera starts a new map at once, and the old one keeps looking for a few frames more: whichever first knows where
the camera is goes on. No frame is read twice; only the reference images are kept.
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from haustra.core.ray_table import RayTable
from pipeline.config import OdometrySettings
from pipeline.frontend.odometry.initialization import Initializer
from pipeline.frontend.odometry.klt import TrackerImage, tracker_image
from pipeline.frontend.odometry.tracking import Tracker
from pipeline.mapping.local_map import LocalMap

MAX_LOST_FRAMES = 10  # frames for which a lost map goes on looking
MAX_JUMP = 15  # frames without a picture after which the old map is not asked any more
CHECKED_KEYFRAMES = 4  # keyframes within which the lamp can disown a new map
MAX_LIGHTING_CORRELATION = 0.0  # rank correlation of distance and brightness above which it does
MIN_KEYFRAMES = 3  # of a map that is kept
KEYFRAME_MOTION = OdometrySettings().keyframe_motion

State = Literal["starting", "tracking", "lost"]


class Odometry:
    """Feed it frames in order, then ask for the maps."""

    def __init__(self, rays: RayTable, seed: int, stride: int = 1, keyframe_motion: float = KEYFRAME_MOTION) -> None:
        self.rays, self.stride, self.keyframe_motion = rays, stride, keyframe_motion
        self.rng = np.random.default_rng(seed)
        self.maps: list[LocalMap] = []  # closed ones
        self.tracker: Tracker | None = None
        self.start: Initializer | None = None
        self.lost_frames = 0  # frames since the tracker last knew

    @property
    def state(self) -> State:
        if self.tracker is None:
            return "starting"
        return "tracking" if self.lost_frames == 0 else "lost"

    @property
    def submaps(self) -> int:
        """Maps so far, with the current one."""
        return len(self.maps) + (self.tracker is not None)

    @property
    def keyframe(self) -> int | None:
        """Number of the frame that became the latest keyframe of the current map."""
        return self.tracker.map.keyframes[-1].frame if self.tracker is not None else None

    def view(self, rgb: NDArray[np.uint8], mask: NDArray[np.uint8]) -> TrackerImage:
        """The frame as the tracker needs it; depends on no other frame. rgb (H,W,3) uint8; mask (H,W), nonzero where
        features may lie."""
        return tracker_image(rgb, self.rays.masked(mask))

    def process(self, frame: int, rgb: NDArray[np.uint8], view: TrackerImage) -> State:
        """The next frame and its `view`; `frame` numbers ascend."""
        if self.tracker is not None:
            steps = max(1, round((frame - self.tracker.frame) / self.stride))
            outcome = "lost" if steps > MAX_JUMP else self.tracker.process(frame, steps, view, rgb)
            if outcome != "lost":
                self.lost_frames, self.start = 0, None
                if outcome == "keyframe" and self._fails_lighting_check():
                    self.tracker = None
                return self.state
            self.lost_frames += 1
            if self.lost_frames > MAX_LOST_FRAMES or steps > MAX_JUMP:
                self._close()
        self.start = self.start or Initializer(self.rays, self.rng)
        new_map = self.start.process(frame, view, rgb)
        if new_map is not None:
            self._close()
            tracks, motion = self.start.tracks, self.keyframe_motion
            self.tracker = Tracker(new_map, tracks, view, frame, self.rng, motion, self.stride)
            self.start, self.lost_frames = None, 0
        return self.state

    def finish(self) -> list[LocalMap]:
        """All maps, in the order of their beginning."""
        self._close()
        return self.maps

    def _close(self) -> None:
        if self.tracker is not None and len(self.tracker.map.keyframes) >= MIN_KEYFRAMES:
            self.maps.append(self.tracker.map)
        self.tracker, self.lost_frames = None, 0

    def _fails_lighting_check(self) -> bool:
        """Whether, in a map's first keyframes, near wall is not brighter than far wall."""
        assert self.tracker is not None
        correlations = self.tracker.lighting
        return len(correlations) == CHECKED_KEYFRAMES and float(np.median(correlations)) > MAX_LIGHTING_CORRELATION
