"""The camera's path while frames come, and the keyframes that are worth completing once the map has settled there."""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from haustra.core.ray_table import RayTable
from haustra.core.se3 import Array, inverse
from pipeline.config import FAST_KEYFRAME_MOTION, DepthSettings, OdometrySettings
from pipeline.depth.keyframe_selection import is_new_view
from pipeline.frontend.odometry.tracking import Odometry, State
from pipeline.live.working_view import WorkingFrame, WorkingView
from pipeline.mapping.local_map import Keyframe, LocalMap
from pipeline.mapping.submap import Submap
from pipeline.mapping.submap_of_map import to_submap

SETTLED_BY = 3  # later keyframes, by which the adjustment has seen a keyframe from both sides;
SETTLED_S = 0.8  # or so long after it, where the camera hardly moves
MOST_TRACKED = 1000  # frames between keyframes that are remembered
LEFT_KEYFRAMES = 200  # of a map that was left, by which it may be recognised later
AROUND = 10  # keyframes whose points a keyframe is completed with


@dataclass(frozen=True)
class SettledKeyframe:
    """A keyframe to be completed: its picture, and the map around it.

    map_number: of the submap that it belongs to. row: in `around`. came: when its frame came, by `time.monotonic()`.
    """

    map_number: int
    frame: int
    came: float
    rgb: NDArray[np.uint8]
    mask: NDArray[np.uint8]
    around: Submap
    row: int


@dataclass(frozen=True)
class _Waiting:
    keyframe: Keyframe
    picture: WorkingFrame
    came: float


class LiveTracker:
    """Odometry on frames as they come. It forgets closed maps: what they showed was completed, and is recorded.

    map_number: of the current map, from 0; -1 before the first. last_keyframe: picture to go back to when lost. A map
    that the light contradicts is dropped; `refused`: numbers of those.
    """

    def __init__(self, view: WorkingView, odometry: OdometrySettings, depth: DepthSettings, seed: int) -> None:
        self.view, self.motion = view, depth.keyframe_motion
        # As `--fast` has it: frames must be kept up with, and the run at the end is made with all keyframes.
        motion = max(odometry.keyframe_motion, FAST_KEYFRAME_MOTION)
        self.odometry = Odometry(RayTable(view.camera), seed, keyframe_motion=motion)
        self.map_number = -1
        self.last_keyframe: WorkingFrame | None = None
        self.left: tuple[int, Submap] | None = None  # number and end of the map before, once it was left
        self.refused: set[int] = set()
        self._map: LocalMap | None = None
        self._waiting: deque[_Waiting] = deque()
        self._chosen: Keyframe | None = None  # the latest that was taken to be completed

    @property
    def state(self) -> State:
        return self.odometry.state

    @property
    def world_from_camera(self) -> Array | None:
        """(4,4) of the latest frame that was posed; None before the first."""
        tracker = self.odometry.tracker
        return None if tracker is None else inverse(tracker.camera_from_world)

    def process(self, frame: WorkingFrame, came: float) -> list[SettledKeyframe]:
        """Pose the frame; keyframes of an earlier map, which the camera has left, that are to be completed."""
        odometry = self.odometry
        odometry.process(frame.number, frame.rgb, odometry.view(frame.rgb, frame.mask))
        left = self._follow_map()
        if self._map is not None and len(self._map.tracked_frames) > MOST_TRACKED:
            del self._map.tracked_frames[: MOST_TRACKED // 2]  # older ones are the recording's
        if self._map is not None and odometry.keyframe == frame.number:
            self._waiting.append(_Waiting(self._map.keyframes[-1], frame, came))
            self.last_keyframe = frame
        return left

    def finish(self) -> list[SettledKeyframe]:
        """What still waits, at the end of the source."""
        return self._released(len(self._waiting))

    def submap(self, keyframes: int) -> Submap | None:
        """The latest keyframes of the current map as it is now, without the frames between them; None without enough
        points."""
        if self._map is None:
            return None
        part = self._map.latest(keyframes)
        part.tracked_frames = []  # they take most of the time, and nobody asks for them
        return to_submap(part, self.view.camera.params, refit=False)

    def _follow_map(self) -> list[SettledKeyframe]:
        """Notice that another map was begun; what waits in the old one is taken as it is, unless it was refused."""
        self.odometry.maps.clear()
        tracker = self.odometry.tracker
        now = None if tracker is None else tracker.map
        if self._map is not None and self.odometry.refused_map is self._map:
            self._refuse()
        if now is None or now is self._map:
            return []
        released = self._released(len(self._waiting))
        end = self.submap(LEFT_KEYFRAMES)
        self.left = None if end is None else (self.map_number, end)
        self._map, self._chosen, self.map_number = now, None, self.map_number + 1
        return released

    def _refuse(self) -> None:
        """Forget the current map: nothing of it is to be shown."""
        self.refused.add(self.map_number)
        self._map = self._chosen = self.last_keyframe = None
        self._waiting.clear()

    def settled(self, now: float) -> list[SettledKeyframe]:
        """The keyframes that are to be completed at a time by `time.monotonic()`, whether frames come or not."""
        settled = max(0, len(self._waiting) - SETTLED_BY)
        while settled < len(self._waiting) and now - self._waiting[settled].came > SETTLED_S:
            settled += 1
        return self._released(settled)

    def _released(self, count: int) -> list[SettledKeyframe]:
        """The oldest `count` of those that wait, without those that show nothing new."""
        waiting = [self._waiting.popleft() for _ in range(count)]
        chosen = (self._chosen_one(one) for one in waiting)
        return [keyframe for keyframe in chosen if keyframe is not None]

    def _chosen_one(self, waiting: _Waiting) -> SettledKeyframe | None:
        assert self._map is not None
        keyframe, picture = waiting.keyframe, waiting.picture
        if self._chosen is not None and not self._is_new(keyframe, self._chosen):
            return None
        around = to_submap(self._map.latest(AROUND), self.view.camera.params, refit=False)
        if around is None or picture.number not in around.frames:
            return None
        self._chosen = keyframe
        row = int(np.searchsorted(around.frames, picture.number))
        number, came = self.map_number, waiting.came
        return SettledKeyframe(number, picture.number, came, picture.rgb, picture.mask, around, row)

    def _is_new(self, keyframe: Keyframe, before: Keyframe) -> bool:
        assert self._map is not None
        has_point = self._map.tracks.has_point
        mine, theirs = has_point[keyframe.ids], has_point[before.ids]
        now, then = (keyframe.ids[mine], keyframe.pixels[mine]), (before.ids[theirs], before.pixels[theirs])
        return is_new_view(*now, *then, self.motion * self.view.camera.width)
