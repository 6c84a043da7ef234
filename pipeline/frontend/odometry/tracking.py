"""Tracking: frames go in one by one, each is posed in the local map, and maps come out.

`Tracker` predicts, tracks corners, resects, and makes a keyframe when the view has changed. `Odometry` is the state
machine above it (starting, tracking, lost). A lost camera starts a new map at once, and the old one keeps looking for a
few frames more: whichever first knows where the camera is goes on. No frame is read twice; only the reference images
are kept.
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from haustra.core.rank_correlation import rank_correlation
from haustra.core.ray_table import RayTable
from haustra.core.se3 import Array, angle_between, in_camera, inverse
from pipeline.config import OdometrySettings
from pipeline.frontend.odometry.corner_tracks import CornerTracks
from pipeline.frontend.odometry.initialization import Initializer
from pipeline.frontend.odometry.klt import Pixels, TrackerImage, tracker_image
from pipeline.frontend.odometry.motion_model import MAX_GAP, predicted_pose, velocity_between
from pipeline.frontend.odometry.two_view import USUAL_START, StartLimits
from pipeline.mapping.lighting_check import brightness_of
from pipeline.mapping.local_map import WINDOW, LocalMap
from pipeline.mapping.map_adjustment import LOSS_PX, adjust_window
from pipeline.optimization.resection import refine_pose, reprojection_errors, robust_pose

INLIER_PX = 2.0
MIN_INLIERS = 20
MIN_INLIER_SHARE = 0.5  # of the points that were found again
SURE_SHARE = 0.75  # below it sample consensus has a say too
MIN_FOUND_SHARE = 0.15  # of the points that should be in view
MAX_STEP = 0.5  # median depths between two frames
MAX_TURN = np.radians(25.0)  # between two frames
KEYFRAME_FOUND_SHARE = 0.7  # of the reference's tracks; fewer, and the view has changed
ADJUST_AFTER = 3  # frames: where each one becomes a keyframe, an adjustment for each would take most of the time
ADJUST_AFTER_GUESS = 1  # with a guessed lens, which bends the map: what is left bent longer is lost more often
MIN_CHECKED_POINTS = 15

MAX_LOST_FRAMES = 10  # frames for which a lost map goes on looking
MAX_JUMP = 15  # frames without a picture after which the old map is not asked any more
CHECKED_KEYFRAMES = 4  # first keyframes of a map, by which the lighting check judges it
MAX_LIGHTING_CORRELATION = 0.0  # rank correlation of distance and brightness above which it is dropped
MIN_KEYFRAMES = 3  # of a map that is kept
KEYFRAME_MOTION = OdometrySettings().keyframe_motion

Outcome = Literal["tracked", "keyframe", "lost"]
State = Literal["starting", "tracking", "lost"]


class Tracker:
    """Poses frames in `map`; `tracks` must be those from which the map's last keyframe was made.

    keyframe_motion: share of the width that tracks move by, in the median, until the next keyframe."""

    def __init__(
        self,
        local_map: LocalMap,
        tracks: CornerTracks,
        view: TrackerImage,
        frame: int,
        rng: np.random.Generator,
        keyframe_motion: float,
        stride: int = 1,
    ) -> None:
        self.map, self.tracks, self.rng, self.keyframe_motion = local_map, tracks, rng, keyframe_motion
        self.camera_from_world = local_map.keyframes[-1].camera_from_world
        self.frame = frame
        self.velocity = self._initial_velocity(stride)
        self.adjust_after = ADJUST_AFTER if local_map.rays.camera.trusted else ADJUST_AFTER_GUESS
        self.unadjusted = 0  # frames since the last adjustment
        self.lighting: list[float] = []  # rank correlation of distance and brightness at each keyframe
        self._set_reference(view)

    def process(self, frame: int, steps: int, view: TrackerImage, rgb: NDArray[np.uint8]) -> Outcome:
        """Pose the frame, `steps` frame intervals after the last one that was posed."""
        found = self._resect(view, predicted_pose(self.camera_from_world, self.velocity, steps))
        if found is None:
            return "lost"
        camera_from_world, mapped, inlier = found
        if not self._is_plausible(camera_from_world, steps):
            return "lost"
        moved = velocity_between(self.camera_from_world, camera_from_world, steps)
        self.velocity = moved if steps <= MAX_GAP else np.eye(4)
        self.camera_from_world, self.frame = camera_from_world, frame
        self.unadjusted += steps
        tracks = self.tracks
        good = tracks.found.copy()
        good[mapped[~inlier]] = False
        rows = mapped[inlier]
        tracks.found = good
        if not self._needs_keyframe(view.image.shape[1]):
            self.map.add_tracked_frame(frame, camera_from_world, tracks.ids[rows], tracks.now[rows])
            return "tracked"
        self._check_lighting(rgb, rows)
        self._make_keyframe(frame, view)
        return "keyframe"

    def _resect(
        self, view: TrackerImage, predicted: Array
    ) -> tuple[Array, NDArray[np.int64], NDArray[np.bool_]] | None:
        """Pose, rows of the found tracks that have points, and which of them agree."""
        tracks = self.tracks
        known = self.map.tracks.has_point[tracks.ids]
        tracks.follow(view, self._guess(known, predicted))
        mapped = np.flatnonzero(tracks.found & known)
        if len(mapped) < max(MIN_INLIERS, MIN_FOUND_SHARE * known.sum()):
            return None
        points = self.map.tracks.points[tracks.ids[mapped]]
        xy, jacobian = self.map.rays.unproject(tracks.now[mapped])
        camera_from_world = refine_pose(predicted, points, xy, jacobian, 2 * LOSS_PX)
        errors = reprojection_errors(camera_from_world, points, xy, jacobian)
        if (errors < INLIER_PX).mean() < SURE_SHARE:
            other = robust_pose(points, xy, jacobian, INLIER_PX, self.rng)
            if other is not None:
                others = reprojection_errors(other, points, xy, jacobian)
                if (others < INLIER_PX).sum() > (errors < INLIER_PX).sum():
                    camera_from_world, errors = other, others
        inlier = errors < INLIER_PX
        if inlier.sum() < MIN_INLIERS or inlier.mean() < MIN_INLIER_SHARE:
            return None
        camera_from_world = refine_pose(
            camera_from_world, points[inlier], xy[inlier], jacobian[inlier], LOSS_PX, iterations=4
        )
        return camera_from_world, mapped, reprojection_errors(camera_from_world, points, xy, jacobian) < INLIER_PX

    def _guess(self, known: NDArray[np.bool_], predicted: Array) -> Pixels:
        """(N,2) where each track should be. A track without a point borrows the depth of the nearest one that has."""
        tracks, last = self.tracks, self.map.keyframes[-1]
        if not known.any():
            return np.full(tracks.now.shape, np.nan, dtype=np.float32)
        points = self.map.tracks.points[tracks.ids]
        if not known.all():
            depth = in_camera(last.camera_from_world, points[known])[:, 2]
            _, nearest = cKDTree(tracks.reference_pixels[known]).query(tracks.reference_pixels[~known])
            xy, _ = self.map.rays.unproject(tracks.reference_pixels[~known])
            local = np.concatenate([xy, np.ones((len(xy), 1))], axis=1) * depth[nearest][:, None]
            points[~known] = in_camera(inverse(last.camera_from_world), local)
        return self.map.rays.project(in_camera(predicted, points)).astype(np.float32)

    def _is_plausible(self, camera_from_world: Array, steps: int) -> bool:
        """An endoscope does not jump: a pose far from the last one is a false fit."""
        step = float(np.linalg.norm(inverse(camera_from_world)[:3, 3] - inverse(self.camera_from_world)[:3, 3]))
        limit = min(steps, MAX_GAP)
        depth = self.map.median_depth(self.map.keyframes[-1])
        return (
            step < MAX_STEP * limit * depth
            and angle_between(camera_from_world, self.camera_from_world) < MAX_TURN * limit
        )

    def _needs_keyframe(self, width: int) -> bool:
        tracks = self.tracks
        return tracks.motion_px() > self.keyframe_motion * width or tracks.found_share() < KEYFRAME_FOUND_SHARE

    def _make_keyframe(self, frame: int, view: TrackerImage) -> None:
        """The frame enters the map, which is adjusted around it if that is due, and tracking goes on from its image."""
        tracks = self.tracks
        self.map.add_keyframe(frame, self.camera_from_world, tracks.ids[tracks.found], tracks.now[tracks.found])
        self.map.triangulate_new()
        if self.unadjusted >= self.adjust_after or len(self.map.keyframes) <= WINDOW:
            adjust_window(self.map)
            self.unadjusted = 0
        self.map.forget_unused()
        self.camera_from_world = self.map.keyframes[-1].camera_from_world
        self._set_reference(view)

    def _set_reference(self, view: TrackerImage) -> None:
        """Move the reference frame to the last keyframe's image; its new corners belong to that keyframe too."""
        tracks = self.tracks
        tracks.found &= ~self._rejected()
        begun = tracks.count
        tracks.set_reference(view)
        self.map.tracks.reserve(tracks.count)
        fresh = tracks.ids >= begun
        self.map.extend(-1, tracks.ids[fresh], tracks.now[fresh])

    def _rejected(self) -> NDArray[np.bool_]:
        self.map.tracks.reserve(self.tracks.count)
        return self.map.tracks.rejected[self.tracks.ids]

    def _check_lighting(self, rgb: NDArray[np.uint8], rows: NDArray[np.int64]) -> None:
        """Is nearer brighter here? A map that starts false contradicts its lamp."""
        if len(rows) < MIN_CHECKED_POINTS:
            return
        pixels = self.tracks.now[rows]
        x, y = np.floor(pixels).astype(int).T
        distance = np.linalg.norm(
            in_camera(self.camera_from_world, self.map.tracks.points[self.tracks.ids[rows]]), axis=1
        )
        self.lighting.append(float(np.nan_to_num(rank_correlation(distance, brightness_of(rgb)[y, x]))))

    def _initial_velocity(self, stride: int) -> Array:
        """From the map's last two keyframes, for one step of `stride` frame numbers."""
        if len(self.map.keyframes) < 2:
            return np.eye(4)
        before, last = self.map.keyframes[-2:]
        steps = max(1, round(abs(last.frame - before.frame) / stride))
        return velocity_between(before.camera_from_world, last.camera_from_world, steps)


class Odometry:
    """Feed it frames in order, then ask for the maps."""

    def __init__(
        self,
        rays: RayTable,
        seed: int,
        stride: int = 1,
        keyframe_motion: float = KEYFRAME_MOTION,
        limits: StartLimits = USUAL_START,
    ) -> None:
        self.rays, self.stride, self.keyframe_motion, self.limits = rays, stride, keyframe_motion, limits
        self.rng = np.random.default_rng(seed)
        self.maps: list[LocalMap] = []  # closed ones
        self.begun = 0  # maps, with those that were too short or that the light contradicted
        self.tracker: Tracker | None = None
        self.initializer: Initializer | None = None
        self.lost_frames = 0  # frames since the tracker last knew
        self.refused_map: LocalMap | None = None  # the latest map that the light contradicted

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
                self.lost_frames, self.initializer = 0, None
                if outcome == "keyframe" and self._fails_lighting_check():
                    self.refused_map, self.tracker = self.tracker.map, None
                return self.state
            self.lost_frames += 1
            if self.lost_frames > MAX_LOST_FRAMES or steps > MAX_JUMP:
                self._close()
        self.initializer = self.initializer or Initializer(self.rays, self.rng, self.limits)
        new_map = self.initializer.process(frame, view, rgb)
        if new_map is not None:
            self.begun += 1
            self._close()
            tracks, motion = self.initializer.tracks, self.keyframe_motion
            self.tracker = Tracker(new_map, tracks, view, frame, self.rng, motion, self.stride)
            self.initializer, self.lost_frames = None, 0
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
