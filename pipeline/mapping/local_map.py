"""The map of one submap while it grows: keyframes with what they saw, points by track number, poses of all frames.

Memory follows the map: keyframes and points, no images. A frame between keyframes leaves its pose relative to the
keyframe before it and 12 bytes for each point that it saw, which the result needs. The map's adjustment is in
`map_adjustment`.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from haustra.core.ray_table import RayTable
from haustra.core.se3 import Array, compose, in_camera, inverse, scaled
from pipeline.matching.feature_tracks import FeatureTracks
from pipeline.matching.keyframe_features import SparseView
from pipeline.optimization.triangulation import triangulate

WINDOW = 8  # latest keyframes, those that a local bundle adjustment moves
MAX_BIRTH_ERROR_PX = 1.2  # of a new point, in all its views
MIN_ANGLE = np.radians(1.2)  # of a new point's rays; a third of a pixel is then a tenth of the depth
ROOM = 1024  # tracks that a new map has room for

# Depth (N,) in mm that a sensor measured at pixels (N,2) of a frame, and its standard deviation (N,); both 0 = none.
DepthAt = Callable[[int, NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64]]]


class TrackKind(IntEnum):
    """How a track's observations were found."""

    KLT = 0  # a corner that was tracked from frame to frame
    MERGE = 1  # SIFT features of two submaps that were matched when these were merged
    WIDE_FEATURE = 2  # SIFT features matched between keyframes, that follow the map
    FEATURE = 3  # SIFT features matched between keyframes, that the map was adjusted to


FEATURES = (TrackKind.WIDE_FEATURE, TrackKind.FEATURE)


@dataclass
class MapTracks:
    """Arrays by track number: points (T,3); has_point (T,): whether there is one; rejected (T,): whether it was found
    wrong; kind (T,): a `TrackKind`."""

    points: Array = field(default_factory=lambda: np.zeros((ROOM, 3)))
    has_point: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(ROOM, dtype=bool))
    rejected: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(ROOM, dtype=bool))
    kind: NDArray[np.uint8] = field(default_factory=lambda: np.zeros(ROOM, dtype=np.uint8))

    def __len__(self) -> int:
        return len(self.has_point)

    def reserve(self, count: int) -> None:
        """Make room for track numbers below `count`."""
        while len(self) < count:
            for name, array in vars(self).items():
                setattr(self, name, np.concatenate([array, np.zeros_like(array)]))

    def truncate(self, count: int) -> None:
        """Forget the tracks from number `count` on."""
        for name, array in vars(self).items():
            setattr(self, name, array[:count])

    def place(self, first: int, other: "MapTracks") -> None:
        """The other's tracks as numbers `first` and on."""
        self.reserve(first + len(other))
        for name, array in vars(self).items():
            array[first : first + len(other)] = getattr(other, name)

    def is_kind(self, *kinds: TrackKind) -> NDArray[np.bool_]:
        """(T,) whether each track is of one of these kinds."""
        return np.isin(self.kind, kinds)


@dataclass
class Keyframe:
    """camera_from_world (4,4); ids (N,), pixels (N,2), xy (N,2) and jacobian (N,2,2) of the tracks in it."""

    frame: int
    camera_from_world: Array
    ids: NDArray[np.int64]
    pixels: Array
    xy: Array
    jacobian: Array

    def keep(self, mask: NDArray[np.bool_]) -> None:
        self.ids, self.pixels, self.xy = self.ids[mask], self.pixels[mask], self.xy[mask]
        self.jacobian = self.jacobian[mask]


@dataclass(frozen=True)
class TrackedFrame:
    """A frame between keyframes: its pose from the camera of keyframe number `keyframe`, and the points it saw."""

    frame: int
    keyframe: int
    camera_from_keyframe: Array
    ids: NDArray[np.int32]
    pixels: NDArray[np.float32]

    def scaled(self, factor: float) -> "TrackedFrame":
        """The same in a map whose unit is smaller by `factor`."""
        return replace(self, camera_from_keyframe=scaled(self.camera_from_keyframe, factor))


class LocalMap:
    """Keyframes, tracks with their points, and tracked frames in one scene frame.

    depth_at: what a sensor measured, where the map is in millimetres; its adjustments then hold to it.
    """

    def __init__(self, rays: RayTable) -> None:
        self.rays = rays
        self.depth_at: DepthAt | None = None
        self.tracks = MapTracks()
        self.keyframes: list[Keyframe] = []
        self.tracked_frames: list[TrackedFrame] = []

    @property
    def frames(self) -> set[int]:
        """Numbers of all frames that the map poses."""
        return {k.frame for k in self.keyframes} | {p.frame for p in self.tracked_frames}

    def copied(self) -> "LocalMap":
        """A copy that shares the lens's rays and the sensor, which no adjustment changes."""
        shared = {id(one): one for one in (self.rays, self.depth_at) if one is not None}
        return copy.deepcopy(self, shared)

    def latest(self, count: int) -> "LocalMap":
        """The map of its latest `count` keyframes and the frames after the first of them; tracks and keyframes are
        shared, not copied."""
        part, first = LocalMap(self.rays), max(0, len(self.keyframes) - count)
        part.depth_at, part.tracks, part.keyframes = self.depth_at, self.tracks, self.keyframes[first:]
        for tracked in reversed(self.tracked_frames):  # in the order of their keyframes
            if tracked.keyframe < first:
                break
            part.tracked_frames.insert(0, replace(tracked, keyframe=tracked.keyframe - first))
        return part

    def tracks_in_use(self) -> int:
        """One more than the highest track number that any keyframe holds."""
        return max((int(k.ids.max()) + 1 for k in self.keyframes if len(k.ids)), default=0)

    def add_keyframe(self, frame: int, camera_from_world: Array, ids: NDArray[np.int64], pixels: Array) -> None:
        pixels = np.asarray(pixels, np.float64)
        xy, jacobian = self.rays.unproject(pixels)
        self.keyframes.append(Keyframe(frame, camera_from_world, ids.copy(), pixels, xy, jacobian))

    def extend(self, number: int, ids: NDArray[np.int64], pixels: Array) -> None:
        """More tracks that keyframe `number` sees."""
        keyframe = self.keyframes[number]
        pixels = np.asarray(pixels, np.float64)
        xy, jacobian = self.rays.unproject(pixels)
        keyframe.ids = np.concatenate([keyframe.ids, ids])
        keyframe.pixels = np.concatenate([keyframe.pixels, pixels])
        keyframe.xy, keyframe.jacobian = (
            np.concatenate([keyframe.xy, xy]),
            np.concatenate([keyframe.jacobian, jacobian]),
        )

    def recalibrate(self, rays: RayTable) -> None:
        """Another lens: what the keyframes saw, in new rays. Poses and points must then be adjusted."""
        self.rays = rays
        for keyframe in self.keyframes:
            keyframe.xy, keyframe.jacobian = rays.unproject(keyframe.pixels)

    def rescale(self, factor: float) -> None:
        """Make the unit smaller by `factor`, which all lengths grow by."""
        self.tracks.points *= factor
        for keyframe in self.keyframes:
            keyframe.camera_from_world = scaled(keyframe.camera_from_world, factor)
        self.tracked_frames = [tracked.scaled(factor) for tracked in self.tracked_frames]

    def insert_tracks(self, points: Array, kind: TrackKind) -> NDArray[np.int64]:
        """Numbers (N,) of new tracks with points (N,3), after all others."""
        begun = len(self.tracks)
        self.tracks.reserve(begun + len(points))
        ids = np.arange(begun, begun + len(points))
        self.tracks.points[ids], self.tracks.has_point[ids], self.tracks.kind[ids] = points, True, kind
        return ids

    def insert_features(
        self, tracks: FeatureTracks, pixels: list[Array], kind: TrackKind = TrackKind.FEATURE
    ) -> NDArray[np.int64]:
        """Tracks of features, seen by the keyframes, as new tracks; their numbers (T,). pixels: of each keyframe, of
        all its features (N,2)."""
        ids = self.insert_tracks(tracks.points, kind)
        starts = np.searchsorted(tracks.place, np.arange(len(self.keyframes) + 1))
        for number in range(len(self.keyframes)):
            mine = slice(starts[number], starts[number + 1])
            self.extend(number, ids[tracks.track[mine]], pixels[number][tracks.feature[mine]])
        return ids

    def forget_features(self) -> None:
        """Take out the tracks of SIFT features, which are the last ones, and what keyframes saw of them."""
        found = np.flatnonzero(self.tracks.is_kind(*FEATURES))
        if len(found) == 0:
            return
        first = int(found[0])
        self.tracks.truncate(first)
        for keyframe in self.keyframes:
            keyframe.keep(keyframe.ids < first)

    def add_tracked_frame(self, frame: int, camera_from_world: Array, ids: NDArray[np.int64], pixels: Array) -> None:
        relative = camera_from_world @ inverse(self.keyframes[-1].camera_from_world)
        self.tracked_frames.append(
            TrackedFrame(frame, len(self.keyframes) - 1, relative, ids.astype(np.int32), pixels.astype(np.float32))
        )

    def camera_from_world_of(self, tracked: TrackedFrame) -> Array:
        return tracked.camera_from_keyframe @ self.keyframes[tracked.keyframe].camera_from_world

    def visible_points(self, keyframe: Keyframe) -> tuple[Array, Array]:
        """World points (N,3) of the keyframe's tracks that have one, and where it saw them, pixels (N,2)."""
        has_point = self.tracks.has_point[keyframe.ids]
        return self.tracks.points[keyframe.ids[has_point]], keyframe.pixels[has_point]

    def sparse_view(self, keyframe: Keyframe) -> SparseView:
        """The keyframe and its points as features are matched by them."""
        points, pixels = self.visible_points(keyframe)
        local = in_camera(keyframe.camera_from_world, points)
        return SparseView(keyframe.frame, keyframe.camera_from_world, local, pixels)

    def incidence(self, among: NDArray[np.bool_] | None = None) -> csr_array:
        """(keyframes, tracks) ones where a keyframe sees a known point, `among` (T,) these tracks."""
        usable = self.tracks.has_point if among is None else self.tracks.has_point & among
        ids = [np.unique(k.ids[usable[k.ids]]) for k in self.keyframes]
        starts = np.concatenate([[0], np.cumsum([len(i) for i in ids])])
        columns = np.concatenate([np.zeros(0, np.int64), *ids])
        return csr_array((np.ones(len(columns)), columns, starts), shape=(len(ids), len(usable)))

    def median_depth(self, keyframe: Keyframe) -> float:
        """Median z-depth of the keyframe's points; 1 if it has none."""
        points, _ = self.visible_points(keyframe)
        return float(np.median(in_camera(keyframe.camera_from_world, points)[:, 2])) if len(points) else 1.0

    def triangulate_new(self) -> None:
        """Points for the tracks that the latest keyframes see from far enough apart."""
        recent, tracks = self.keyframes[-WINDOW:], self.tracks
        ids = np.concatenate([k.ids for k in recent])
        row = np.repeat(np.arange(len(recent)), [len(k.ids) for k in recent])
        take = ~tracks.has_point[ids] & ~tracks.rejected[ids]
        repeated = np.bincount(ids[take], minlength=len(tracks)) >= 2
        order = np.flatnonzero(take & repeated[ids])
        order = order[np.argsort(ids[order], kind="stable")]
        if len(order) == 0:
            return
        fresh, point = np.unique(ids[order], return_inverse=True)
        cameras_from_world = np.stack([k.camera_from_world for k in recent])[row[order]]
        xy = np.concatenate([k.xy for k in recent])[order]
        jacobian = np.concatenate([k.jacobian for k in recent])[order]
        found, error, angle = triangulate(
            cameras_from_world[:, :3, :3], cameras_from_world[:, :3, 3], point, len(fresh), xy, jacobian
        )
        good = (error < MAX_BIRTH_ERROR_PX) & (angle > MIN_ANGLE)
        tracks.points[fresh[good]] = found[good]
        tracks.has_point[fresh[good]] = True

    def forget_unused(self) -> None:
        """Keyframes that left the window keep only tracks that became points."""
        if len(self.keyframes) > WINDOW:
            keyframe = self.keyframes[-WINDOW - 1]
            keyframe.keep(self.tracks.has_point[keyframe.ids])

    def propagate(
        self, first: int, reference: int, old: Array, scale: float, among: NDArray[np.bool_] | None = None
    ) -> None:
        """Move keyframes from number `first` on, the points that they alone see, and the frames between them, as
        keyframe `reference` before them was moved: from camera_from_world `old` (4,4), with its points `scale` times as
        far from it.

        among (T,): tracks that are moved; frames between keyframes then stay, since they saw others.
        """
        now, tracks = self.keyframes[reference].camera_from_world, self.tracks
        ahead = np.zeros(len(tracks), dtype=bool)
        for keyframe in self.keyframes[first:]:
            camera_from_world = scaled(keyframe.camera_from_world @ inverse(old), scale) @ now
            # Brought back to a rotation: `old` is one of these poses the next time, and rounding would grow threefold.
            keyframe.camera_from_world = compose(camera_from_world[:3, :3], camera_from_world[:3, 3])
            ahead[keyframe.ids] = True
        for keyframe in self.keyframes[:first]:
            ahead[keyframe.ids] = False
        if among is None:
            self.tracked_frames = [
                tracked.scaled(scale) if tracked.keyframe >= first else tracked for tracked in self.tracked_frames
            ]
        else:
            ahead &= among
        tracks.points[ahead] = in_camera(inverse(now), scale * in_camera(old, tracks.points[ahead]))
