"""SIFT features of a keyframe, lifted to points by the depth of the sparse points around them.

Interpolated depth is off by a few percent, which two views of one place forgive, and far more features get one than by
matching neighbouring keyframes.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, cKDTree

from haustra.core.ray_table import RayTable
from haustra.core.se3 import Array, in_camera, inverse
from pipeline.matching.depth_interpolation import delaunay, interpolate_inverse_depth
from pipeline.matching.sift import FindFeatures, SiftFeatures, rootsift

MIN_FEATURES = 25  # of a keyframe that is compared with others


@dataclass(frozen=True)
class KeyframeFeatures:
    """keyframe: its number in its map. pixels (N,2); descriptors (N,128) as SIFT gives them; points (N,3) in the
    camera's axes; sizes (N,) in pixels; extrapolated (N,): the depth is that of the nearest sparse point, a guess.
    rows (N,): which of its picture's features they are, where they were lifted from these."""

    keyframe: int
    pixels: Array
    descriptors: NDArray[np.uint8]
    points: Array
    sizes: Array
    extrapolated: NDArray[np.bool_]
    rows: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))

    def __len__(self) -> int:
        return len(self.pixels)

    @property
    def rootsift(self) -> NDArray[np.float32]:
        """(N,128); computed at each call, since the features of all maps' keyframes are held at once."""
        return rootsift(self.descriptors)

    @cached_property
    def triangles(self) -> Delaunay | None:
        """Triangulation of `pixels`; a keyframe is asked for its surface dozens of times."""
        return delaunay(self.pixels)

    def world_points(self, camera_from_world: Array) -> Array:
        """`points` (N,3) in the world of a camera."""
        return in_camera(inverse(camera_from_world), self.points)

    @staticmethod
    def none(keyframe: int) -> "KeyframeFeatures":
        """The features of a keyframe that has none."""
        flat, empty = np.zeros((0, 2)), np.zeros(0)
        return KeyframeFeatures(
            keyframe, flat, np.zeros((0, 128), np.uint8), np.zeros((0, 3)), empty, np.zeros(0, bool)
        )


@dataclass(frozen=True)
class SparseView:
    """A keyframe as its features are lifted: its frame's number, camera_from_world (4,4), and its sparse points, (K,3)
    in the camera's axes, seen at pixels (K,2)."""

    frame: int
    camera_from_world: Array
    points: Array
    pixels: Array


def features_of_view(
    number: int, view: SparseView, rays: RayTable, find: FindFeatures, extrapolate: bool = False
) -> KeyframeFeatures:
    """Features of keyframe `number`; none where it sees too few points. extrapolate: see `lift_features`."""
    if len(view.points) < MIN_FEATURES:
        return KeyframeFeatures.none(number)
    depth = view.points[:, 2]
    front = depth > 0
    enough = extrapolate and int(front.sum()) >= MIN_FEATURES
    return lift_features(number, find(view.frame), rays, view.pixels[front], depth[front], enough)


def lift_features(
    keyframe: int, found: SiftFeatures, rays: RayTable, pixels: Array, depth: Array, extrapolate: bool = False
) -> KeyframeFeatures:
    """Features within the hull of the sparse points at `pixels` (K,2) of depth (K,), where the lens has rays.

    extrapolate: beyond the hull too, as deep as the nearest sparse point.
    """
    x, y = np.floor(found.pixels).astype(int).T
    usable = rays.usable[y, x] > 0
    found = found.at(usable)
    if len(found.pixels) == 0 or len(depth) == 0:
        return KeyframeFeatures.none(keyframe)
    inverse_depth = interpolate_inverse_depth(found.pixels, delaunay(pixels), depth)
    outside = ~np.isfinite(inverse_depth)
    if extrapolate:
        inverse_depth[outside] = 1 / depth[cKDTree(pixels).query(found.pixels[outside])[1]]
    good = np.isfinite(inverse_depth)
    xy, _ = rays.unproject(found.pixels[good])
    points = np.concatenate([xy, np.ones((len(xy), 1))], axis=1) / inverse_depth[good, None]
    rows = np.flatnonzero(usable)[good]
    return KeyframeFeatures(
        keyframe, found.pixels[good], found.descriptors[good], points, found.sizes[good], outside[good], rows
    )


def without_descriptors(features: KeyframeFeatures) -> KeyframeFeatures:
    """All that tells where features are; what tells them apart is nearly all of their memory."""
    return replace(features, descriptors=np.zeros((0, 128), np.uint8))
