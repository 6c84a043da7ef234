"""The map of one submap while it grows: keyframes with what they saw, points by track number, poses of all frames.

Memory follows the map: keyframes and points, no images. A frame between keyframes leaves its pose relative to the
keyframe before it and 12 bytes for each point that it saw, which the result needs.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from haustra.core.ray_table import RayTable
from haustra.core.se3 import Array, compose, in_camera, inverse, scaled
from pipeline.optimization.bundle_adjustment import DAMPING, TOLERANCE, Bundle, adjust
from pipeline.optimization.triangulation import triangulate

WINDOW = 8  # keyframes that a bundle adjustment moves
ANCHORS = 6  # others that saw the same points and stay
MIN_SHARED = 10  # points that such a one must share; fewer do not hold a scene
WINDOW_ITERATIONS = 2  # each keyframe is in several windows; six iterations gave no better a path in the end
LOSS_PX = 0.8  # Cauchy; tracking errs by 0.2 to 0.5 px
MAX_ERROR_PX = 2.0  # of an observation that is kept
MAX_BIRTH_ERROR_PX = 1.2  # of a new point, in all its views
MIN_ANGLE = np.radians(1.2)  # of a new point's rays; a third of a pixel is then a tenth of the depth
CHUNK = 50_000  # points fitted at once: a few hundred megabytes


@dataclass
class Keyframe:
    """camera_from_world pose (4,4); ids (N,), pixels (N,2), seen (N,2) and gain (N,2,2) of the tracks in it."""

    frame: int
    pose: Array
    ids: NDArray[np.int64]
    pixels: Array
    seen: Array
    gain: Array

    def keep(self, mask: NDArray[np.bool_]) -> None:
        self.ids, self.pixels, self.seen = self.ids[mask], self.pixels[mask], self.seen[mask]
        self.gain = self.gain[mask]


@dataclass(frozen=True)
class PosedFrame:
    """A frame between keyframes: its pose from the camera of keyframe number `keyframe`, and the points it saw."""

    frame: int
    keyframe: int
    from_keyframe: Array
    ids: NDArray[np.int32]
    pixels: NDArray[np.float32]

    def scaled(self, factor: float) -> "PosedFrame":
        """The same in a map whose unit is smaller by `factor`."""
        return replace(self, from_keyframe=scaled(self.from_keyframe, factor))


class LocalMap:
    """Keyframes, points and posed frames in one scene frame."""

    def __init__(self, rays: RayTable) -> None:
        self.rays = rays
        self.points = np.zeros((1024, 3))
        self.known = np.zeros(1024, dtype=bool)  # tracks that have a point
        self.barred = np.zeros(1024, dtype=bool)  # tracks whose point was found wrong
        self.followed = np.ones(1024, dtype=bool)  # the others were found in each keyframe for itself
        self.keyframes: list[Keyframe] = []
        self.posed: list[PosedFrame] = []
        self.first_feature: int | None = None  # tracks from here on were not followed but found anew, see `refit`
        self.first_of_last: int | None = None  # tracks from here on came with the last `add_features`

    def reserve(self, count: int) -> None:
        """Make room for track numbers below `count`."""
        while len(self.known) < count:
            size = len(self.known)
            self.points = np.concatenate([self.points, np.zeros((size, 3))])
            self.known = np.concatenate([self.known, np.zeros(size, dtype=bool)])
            self.barred = np.concatenate([self.barred, np.zeros(size, dtype=bool)])
            self.followed = np.concatenate([self.followed, np.ones(size, dtype=bool)])

    def tracks_in_use(self) -> int:
        """One more than the highest track number that any keyframe holds."""
        return max((int(k.ids.max()) + 1 for k in self.keyframes if len(k.ids)), default=0)

    def add_keyframe(self, frame: int, pose: Array, ids: NDArray[np.int64], pixels: Array) -> None:
        pixels = np.asarray(pixels, np.float64)
        seen, gain = self.rays.look_up(pixels)
        self.keyframes.append(Keyframe(frame, pose, ids.copy(), pixels, seen, gain))

    def extend(self, number: int, ids: NDArray[np.int64], pixels: Array) -> None:
        """More tracks that keyframe `number` sees."""
        keyframe = self.keyframes[number]
        pixels = np.asarray(pixels, np.float64)
        seen, gain = self.rays.look_up(pixels)
        keyframe.ids = np.concatenate([keyframe.ids, ids])
        keyframe.pixels = np.concatenate([keyframe.pixels, pixels])
        keyframe.seen, keyframe.gain = np.concatenate([keyframe.seen, seen]), np.concatenate([keyframe.gain, gain])

    def recalibrate(self, rays: RayTable) -> None:
        """Another lens: what the keyframes saw, in new rays. Poses and points must then be adjusted."""
        self.rays = rays
        for keyframe in self.keyframes:
            keyframe.seen, keyframe.gain = rays.look_up(keyframe.pixels)

    def add_features(self, points: Array, known: NDArray[np.bool_]) -> NDArray[np.int64]:
        """New tracks (N,) for points (N,3), after all others; those of all calls can be forgotten together."""
        begun = self.first_of_last = len(self.known)
        self.first_feature = begun if self.first_feature is None else self.first_feature
        self.reserve(begun + len(points))
        ids = np.arange(begun, begun + len(points))
        self.points[ids], self.known[ids], self.followed[ids] = points, known, False
        return ids

    def forget_features(self) -> None:
        """Undo `add_features`."""
        if self.first_feature is None:
            return
        first = self.first_feature
        self.points, self.known, self.barred = self.points[:first], self.known[:first], self.barred[:first]
        self.followed = self.followed[:first]
        for keyframe in self.keyframes:
            keyframe.keep(keyframe.ids < first)
        self.first_feature = self.first_of_last = None

    def of_features(self) -> "LocalMap":
        """The keyframes with what `add_features` gave them last, the features that moved the map; it shares the points
        with this map."""
        part = LocalMap(self.rays)
        part.points, part.known, part.barred, part.followed = self.points, self.known, self.barred, self.followed
        first = len(self.known) if self.first_of_last is None else self.first_of_last
        for keyframe in self.keyframes:
            mine = keyframe.ids >= first
            part.add_keyframe(keyframe.frame, keyframe.pose, keyframe.ids[mine], keyframe.pixels[mine])
        return part

    def add_posed(self, frame: int, pose: Array, ids: NDArray[np.int64], pixels: Array) -> None:
        relative = pose @ inverse(self.keyframes[-1].pose)
        self.posed.append(
            PosedFrame(frame, len(self.keyframes) - 1, relative, ids.astype(np.int32), pixels.astype(np.float32))
        )

    def pose_of(self, posed: PosedFrame) -> Array:
        return posed.from_keyframe @ self.keyframes[posed.keyframe].pose

    def triangulate_new(self, window: int = WINDOW, min_angle: float = MIN_ANGLE) -> None:
        """Points for the tracks that the latest keyframes see from far enough apart."""
        recent = self.keyframes[-window:]
        ids = np.concatenate([k.ids for k in recent])
        row = np.repeat(np.arange(len(recent)), [len(k.ids) for k in recent])
        take = ~self.known[ids] & ~self.barred[ids]
        repeated = np.bincount(ids[take], minlength=len(self.known)) >= 2
        order = np.flatnonzero(take & repeated[ids])
        order = order[np.argsort(ids[order], kind="stable")]
        if len(order) == 0:
            return
        tracks, point = np.unique(ids[order], return_inverse=True)
        poses = np.stack([k.pose for k in recent])[row[order]]
        seen = np.concatenate([k.seen for k in recent])[order]
        gain = np.concatenate([k.gain for k in recent])[order]
        found, error, angle = triangulate(poses[:, :3, :3], poses[:, :3, 3], point, len(tracks), seen, gain)
        good = (error < MAX_BIRTH_ERROR_PX) & (angle > min_angle)
        self.points[tracks[good]] = found[good]
        self.known[tracks[good]] = True

    def adjust(
        self,
        window: int = WINDOW,
        iterations: int = WINDOW_ITERATIONS,
        end: int | None = None,
        loss_px: float = LOSS_PX,
        max_error_px: float = MAX_ERROR_PX,
        anchors: int = ANCHORS,
        tolerance: float = TOLERANCE,
        damping: float = DAMPING,
    ) -> None:
        """Bundle adjustment of the `window` keyframes before number `end` (the latest ones) and of their points.

        The `anchors` older ones that share most points with them hold the scene; without any, the first of the window
        does.
        """
        end = len(self.keyframes) if end is None else end
        first = max(0, end - window)
        free = self.keyframes[first:end]
        held = self._sharing(free, self.keyframes[:first], anchors)
        bundle, tracks = self._bundle(held, free)
        if len(tracks) == 0:
            return
        result = adjust(bundle, iterations, loss_px, tolerance, damping)
        for number, keyframe in enumerate(free, start=len(held)):
            keyframe.pose = compose(result.rotation[number], result.translation[number])
        self.points[tracks] = result.points
        self._cull(result, tracks, held + free, max_error_px)

    def carry(self, first: int, guide: int, old: Array, scale: float) -> None:
        """Move keyframes from number `first` on, the points that they alone see, and the frames between them, as
        keyframe `guide` before them was moved: from pose `old`, with its points `scale` times as far from it."""
        now = self.keyframes[guide].pose
        ahead = np.zeros(len(self.known), dtype=bool)
        for keyframe in self.keyframes[first:]:
            pose = scaled(keyframe.pose @ inverse(old), scale) @ now
            # Brought back to a rotation: `old` is one of these poses the next time, and rounding would grow threefold.
            keyframe.pose = compose(pose[:3, :3], pose[:3, 3])
            ahead[keyframe.ids] = True
        for keyframe in self.keyframes[:first]:
            ahead[keyframe.ids] = False
        self.points[ahead] = in_camera(inverse(now), scale * in_camera(old, self.points[ahead]))
        self.posed = [posed.scaled(scale) if posed.keyframe >= first else posed for posed in self.posed]

    def fit_points(self, iterations: int = 10) -> None:
        """All points fitted to the keyframes as they stand, `CHUNK` at a time, and those dropped that do not fit."""
        for first in range(0, len(self.known), CHUNK):
            chunk = np.zeros_like(self.known)
            chunk[first : first + CHUNK] = True
            bundle, tracks = self._bundle([], self.keyframes, chunk)
            if len(tracks) == 0:
                continue
            fixed = np.ones(len(bundle.fixed), dtype=bool)
            result = adjust(replace(bundle, fixed=fixed), iterations, LOSS_PX)
            self.points[tracks] = result.points
            self._cull(result, tracks, self.keyframes, MAX_ERROR_PX)

    def _sharing(self, free: list[Keyframe], others: list[Keyframe], most: int) -> list[Keyframe]:
        """Those of `others` that see most points of `free`, at most so many, in their order."""
        wanted = np.zeros(len(self.known), dtype=bool)
        for keyframe in free:
            wanted[keyframe.ids] = True
        wanted &= self.known
        shared = np.array([int(wanted[k.ids].sum()) for k in others], dtype=np.int64)
        best = np.argsort(-shared, kind="stable")[:most]
        return [others[k] for k in np.sort(best[shared[best] >= MIN_SHARED])]

    def _bundle(
        self, held: list[Keyframe], free: list[Keyframe], among: NDArray[np.bool_] | None = None
    ) -> tuple[Bundle, NDArray[np.int64]]:
        """The problem, of points `among` these (all if None), and the track number of each of its points."""
        wanted = np.zeros(len(self.known), dtype=bool)
        for keyframe in free:
            wanted[keyframe.ids] = True
        wanted &= self.known
        if among is not None:
            wanted &= among
        cameras = held + free
        masks = [wanted[k.ids] for k in cameras]
        ids = np.concatenate([k.ids[m] for k, m in zip(cameras, masks, strict=True)])
        tracks, point = np.unique(ids, return_inverse=True)
        fixed = np.zeros(len(cameras), dtype=bool)
        fixed[: max(1, len(held))] = True
        poses = np.stack([k.pose for k in cameras])
        bundle = Bundle(
            poses[:, :3, :3],
            poses[:, :3, 3],
            self.points[tracks],
            np.repeat(np.arange(len(cameras)), [int(m.sum()) for m in masks]),
            point,
            np.concatenate([k.seen[m] for k, m in zip(cameras, masks, strict=True)]),
            np.concatenate([k.gain[m] for k, m in zip(cameras, masks, strict=True)]),
            fixed,
        )
        return bundle, tracks

    def _cull(self, bundle: Bundle, tracks: NDArray[np.int64], cameras: list[Keyframe], max_error_px: float) -> None:
        """Forget observations that do not fit, and points that too few observations hold."""
        local = np.einsum("mij,mj->mi", bundle.rotation[bundle.camera], bundle.points[bundle.point])
        depth = local[:, 2] + bundle.translation[bundle.camera, 2]
        bad = (bundle.errors() > max_error_px) | (depth <= 0)
        if not bad.any():
            return
        left = np.bincount(bundle.point[~bad], minlength=len(tracks))
        lost = tracks[left < 2]
        self.known[lost] = False
        self.barred[lost] = True
        starts = np.searchsorted(bundle.camera, np.arange(len(cameras) + 1))
        for keyframe, (begin, end) in zip(cameras, pairwise(starts.tolist()), strict=True):
            if bad[begin:end].any():
                keyframe.keep(~np.isin(keyframe.ids, tracks[bundle.point[begin:end][bad[begin:end]]]))

    def forget_unused(self) -> None:
        """Keyframes that left the window keep only tracks that became points."""
        if len(self.keyframes) > WINDOW:
            keyframe = self.keyframes[-WINDOW - 1]
            keyframe.keep(self.known[keyframe.ids])

    def median_depth(self, keyframe: Keyframe) -> float:
        """Of the keyframe's points; 1 if it has none."""
        points = self.points[keyframe.ids[self.known[keyframe.ids]]]
        return float(np.median(in_camera(keyframe.pose, points)[:, 2])) if len(points) else 1.0
