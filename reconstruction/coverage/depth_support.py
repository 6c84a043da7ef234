"""Depth support of a fused surface: which vertices its own depth maps saw squarely, and which they saw through.

A completion network bridges the depth step at a fold's rim with a ramp. In the depth map that it arose in, a ramp is
seen at a grazing angle, and other depth maps, which look past the rim, see through it. Real wall behind the fold has
neither property.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from reconstruction.mesh.surface_mesh import SurfaceMesh

Array = NDArray[np.float64]

DEPTH_TOLERANCE = 0.05  # relative depth difference up to which a depth map supports a vertex
MAX_ANGLE_DEG = 70.0  # best angle between ray and normal above which a vertex is dropped
MAX_CONTRADICTION = 0.2  # confidence share of frames that see through a vertex, above which it is dropped
# The last two were chosen on two phantom videos, seeds 11 and 12; docs/lab/coverage.md marks them as not held out.


class DepthSupport:
    """Accumulates support and contradiction of a mesh's vertices over keyframe depth maps; all lengths in one unit."""

    def __init__(self, mesh: SurfaceMesh) -> None:
        self._mesh = mesh
        count = len(mesh.vertices)
        self.best_cosine = np.zeros(count)  # (V,) largest cosine between normal and ray over the supporting frames
        self._supporting = np.zeros(count)  # (V,) sums of confidence
        self._seen_through = np.zeros(count)

    @property
    def contradiction(self) -> Array:
        """(V,) confidence share of frames that see through a vertex, of all that support it or do so; 1 if none."""
        total = self._supporting + self._seen_through
        return np.divide(self._seen_through, total, out=np.ones_like(total), where=total > 0)

    def add(
        self, depth: NDArray[np.float32], confidence: NDArray[np.float32], intrinsics: Array, world_from_camera: Array
    ) -> None:
        """Accumulate a keyframe: z-depth (H,W), 0 = none; confidence (H,W); intrinsics (3,3), the top-left pixel's
        centre at (0.5, 0.5); world_from_camera (4,4)."""
        rotation, centre = world_from_camera[:3, :3], world_from_camera[:3, 3]
        points = (self._mesh.vertices - centre) @ rotation
        ahead = np.flatnonzero(points[:, 2] > 0)
        pixel = points[ahead] @ intrinsics.T
        column, row = np.floor(pixel[:, :2] / pixel[:, 2:]).astype(np.int64).T
        height, width = depth.shape
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        vertex, row, column = ahead[inside], row[inside], column[inside]
        weight = confidence[row, column] * (depth[row, column] > 0)
        tolerance = DEPTH_TOLERANCE * points[vertex, 2]
        supports = (np.abs(depth[row, column] - points[vertex, 2]) <= tolerance) & (weight > 0)
        self._supporting[vertex] += weight * supports
        # Reprojection may miss a fold's crest by a pixel: seen through only if all 3x3 pixels look past the vertex.
        self._seen_through[vertex] += weight * (_nearest_around(depth)[row, column] - points[vertex, 2] > tolerance)
        ray = points[vertex[supports]]
        normal = self._mesh.normals[vertex[supports]] @ rotation
        cosine = -np.einsum("ni,ni->n", ray, normal) / np.linalg.norm(ray, axis=1)
        self.best_cosine[vertex[supports]] = np.maximum(self.best_cosine[vertex[supports]], cosine)

    def supported_faces(self) -> SurfaceMesh:
        """The mesh of those faces whose three vertices pass both thresholds."""
        good = (self.best_cosine >= np.cos(np.radians(MAX_ANGLE_DEG))) & (self.contradiction <= MAX_CONTRADICTION)
        return self._mesh.with_faces(good[self._mesh.faces].all(axis=1))


def _nearest_around(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Least known depth in each 3x3 window (H,W); infinite where a window holds none."""
    known = np.where(depth > 0, depth, np.float32(np.inf))
    return np.asarray(cv2.erode(known, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE), np.float32)
