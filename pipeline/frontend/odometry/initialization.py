"""Initialization of a map: corners are tracked until two frames have enough parallax, then two views are solved."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from haustra.core.ray_table import RayTable
from haustra.core.se3 import Array, inverse
from pipeline.frontend.odometry.corner_tracks import CornerTracks
from pipeline.frontend.odometry.klt import Pixels, TrackerImage
from pipeline.frontend.odometry.two_view import (
    USUAL_START,
    Hypothesis,
    StartLimits,
    TwoViewRays,
    parallax_px,
    start_pose,
)
from pipeline.mapping.lighting_check import brightness_of
from pipeline.mapping.local_map import LocalMap, TrackedFrame
from pipeline.mapping.map_adjustment import LOSS_PX, MAX_ERROR_PX, adjust_window
from pipeline.optimization.resection import refine_pose, reprojection_errors, robust_pose

MIN_COMMON = 60  # tracks between the two frames,
MIN_COMMON_SHARE = 0.4  # and their share of those in the second
REFERENCE_MOTION_SHARE = 0.03  # of the width, after which the reference frame follows
MIN_FOUND_SHARE = 0.6  # of the reference's tracks; fewer, and the reference frame follows
MIN_TRACKS = 40  # fewer than this in a frame: what was followed so far is lost
BUFFER = 240  # frames kept; beyond it every other one is dropped
MIN_POSED = 12  # points that pose a frame of the buffer
BETWEEN = 3  # keyframes made between the two


@dataclass(frozen=True)
class BufferedFrame:
    """A frame not yet posed, and its tracks."""

    frame: int
    ids: NDArray[np.int64]
    pixels: Pixels


class Initializer:
    """Collects frames until `process` gives a map with its first keyframes."""

    def __init__(self, rays: RayTable, rng: np.random.Generator, limits: StartLimits = USUAL_START) -> None:
        self.rays, self.rng, self.limits = rays, rng, limits
        self.tracks = CornerTracks()
        self.buffered: list[BufferedFrame] = []

    def process(self, frame: int, view: TrackerImage, rgb: NDArray[np.uint8]) -> LocalMap | None:
        """The map once the evidence suffices. Its tracks go on in `self.tracks`."""
        tracks, width = self.tracks, view.image.shape[1]
        tracks.follow(view)
        if tracks.reference is None or tracks.found.sum() < MIN_TRACKS:
            self.buffered.clear()
            tracks.found[:] = False
            tracks.set_reference(view)
            self._remember(frame)
            return None
        self._remember(frame)
        new_map = self._try(rgb)
        if new_map is None and (
            tracks.motion_px() > REFERENCE_MOTION_SHARE * width or tracks.found_share() < MIN_FOUND_SHARE
        ):
            tracks.set_reference(view)
        return new_map

    def _remember(self, frame: int) -> None:
        tracks = self.tracks
        self.buffered.append(BufferedFrame(frame, tracks.ids[tracks.found], tracks.now[tracks.found].copy()))
        if len(self.buffered) > BUFFER:
            self.buffered = self.buffered[::2]

    def _try(self, rgb: NDArray[np.uint8]) -> LocalMap | None:
        last = self.buffered[-1]
        enough = max(MIN_COMMON, MIN_COMMON_SHARE * len(last.ids))
        # Among the frames with enough in common, the earliest is the farthest away.
        for number, first in enumerate(self.buffered[:-2]):
            common = np.intersect1d(first.ids, last.ids, assume_unique=True)
            if len(common) >= enough:
                return self._try_pair(number, common, rgb)
        return None

    def _try_pair(self, number: int, common: NDArray[np.int64], rgb: NDArray[np.uint8]) -> LocalMap | None:
        middle = (number + len(self.buffered) - 1) // 2
        common = np.intersect1d(common, self.buffered[middle].ids, assume_unique=True)
        if len(common) < MIN_COMMON:
            return None
        first, second, third = (self._rays(self.buffered[k], common) for k in (number, -1, middle))
        focal = self.rays.focal_px
        if parallax_px(first, second, focal) < self.limits.parallax_px:
            return None
        brightness = self._brightness(common, rgb)
        hypothesis = start_pose(first, second, third, brightness, focal, self.rng, self.limits)
        return None if hypothesis is None else self._build(number, common, hypothesis)

    def _rays(self, buffered: BufferedFrame, common: NDArray[np.int64]) -> TwoViewRays:
        rows = np.searchsorted(buffered.ids, common)  # track numbers ascend
        return TwoViewRays(*self.rays.unproject(buffered.pixels[rows]))

    def _brightness(self, common: NDArray[np.int64], rgb: NDArray[np.uint8]) -> Array:
        last = self.buffered[-1]
        x, y = np.floor(last.pixels[np.searchsorted(last.ids, common)]).astype(int).T
        height, width = rgb.shape[:2]
        return brightness_of(rgb)[y.clip(0, height - 1), x.clip(0, width - 1)].astype(np.float64)

    def _build(self, number: int, common: NDArray[np.int64], hypothesis: Hypothesis) -> LocalMap:
        """Keyframes at both ends and between, points, and poses for every waiting frame that sees enough of them."""
        new_map = LocalMap(self.rays)
        new_map.tracks.reserve(self.tracks.count)
        scale = 1 / float(np.median(hypothesis.points[hypothesis.inlier, 2]))
        tracks = common[hypothesis.inlier]
        new_map.tracks.points[tracks] = hypothesis.points[hypothesis.inlier] * scale
        new_map.tracks.has_point[tracks] = True
        last_from_first = hypothesis.second_from_first.copy()
        last_from_first[:3, 3] *= scale
        end = len(self.buffered) - 1
        cameras_from_world = {number: np.eye(4), end: last_from_first}
        chosen = np.unique(np.linspace(number, end, BETWEEN + 2).round().astype(int))
        guess: Array = np.eye(4)
        for k in chosen[1:-1]:
            found = self._pose(new_map, self.buffered[k], guess)
            if found is not None:
                cameras_from_world[int(k)] = guess = found
        for k in sorted(cameras_from_world):
            buffered = self.buffered[k]
            new_map.add_keyframe(buffered.frame, cameras_from_world[k], buffered.ids, buffered.pixels)
        for _ in range(2):
            new_map.triangulate_new()
            adjust_window(new_map, iterations=15)
        self._pose_rest(new_map, sorted(cameras_from_world))
        return new_map

    def _pose_rest(self, new_map: LocalMap, keyframes: list[int]) -> None:
        """Pose the frames between the keyframes, then those before the first, from near to far."""
        number_of = dict(zip(keyframes, range(len(keyframes)), strict=True))
        order = [*range(keyframes[0], len(self.buffered)), *range(keyframes[0] - 1, -1, -1)]
        posed, owner, guess = [], 0, new_map.keyframes[0].camera_from_world
        for k in order:
            if k in number_of:
                owner = number_of[k]
                guess = new_map.keyframes[owner].camera_from_world
                continue
            if k == keyframes[0] - 1:
                owner, guess = 0, new_map.keyframes[0].camera_from_world
            buffered = self.buffered[k]
            camera_from_world = self._pose(new_map, buffered, guess)
            if camera_from_world is None:
                continue
            guess = camera_from_world
            relative = camera_from_world @ inverse(new_map.keyframes[owner].camera_from_world)
            mine = new_map.tracks.has_point[buffered.ids]
            posed.append(
                TrackedFrame(
                    buffered.frame, owner, relative, buffered.ids[mine].astype(np.int32), buffered.pixels[mine]
                )
            )
        new_map.tracked_frames = sorted(posed, key=lambda p: p.frame)

    def _pose(self, new_map: LocalMap, buffered: BufferedFrame, guess: Array) -> Array | None:
        mine = new_map.tracks.has_point[buffered.ids]
        if mine.sum() < MIN_POSED:
            return None
        points = new_map.tracks.points[buffered.ids[mine]]
        xy, jacobian = self.rays.unproject(buffered.pixels[mine])
        camera_from_world = refine_pose(guess, points, xy, jacobian, LOSS_PX, iterations=15)
        share = (reprojection_errors(camera_from_world, points, xy, jacobian) < MAX_ERROR_PX).mean()
        if share < 0.5:
            other = robust_pose(points, xy, jacobian, MAX_ERROR_PX, self.rng)
            if other is None or (reprojection_errors(other, points, xy, jacobian) < MAX_ERROR_PX).mean() < 0.5:
                return None
            camera_from_world = other
        return camera_from_world
