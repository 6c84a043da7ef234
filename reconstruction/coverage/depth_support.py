"""Depth support of a fused surface: which vertices its own depth maps saw squarely, and which they saw through.

A completion network bridges the depth step at a fold's rim with a ramp. In the depth map that it arose in, a ramp is
seen at a grazing angle, and other depth maps, which look past the rim, see through it. Real wall behind the fold has
neither property.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.numba_cache import compiled
from haustra.core.threads import side_by_side
from reconstruction.mesh.surface_mesh import SurfaceMesh

Array = NDArray[np.float64]
Image = NDArray[np.float32]

FEW = 20_000  # vertices that are not worth a second thread
DEPTH_TOLERANCE = 0.05  # relative depth difference up to which a depth map supports a vertex
MAX_ANGLE_DEG = 70.0  # best angle between ray and normal above which a vertex is dropped
MAX_CONTRADICTION = 0.2  # confidence share of frames that see through a vertex, above which it is dropped
# The last two were chosen on two phantom videos, seeds 11 and 12.


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

    def add(self, depth: Image, confidence: Image, intrinsics: Array, world_from_camera: Array) -> None:
        """Accumulate a keyframe: z-depth (H,W), 0 = none; confidence (H,W); intrinsics (3,3), the top-left pixel's
        centre at (0.5, 0.5); world_from_camera (4,4)."""
        view = (
            np.ascontiguousarray(depth, np.float32),
            _nearest_around(depth),
            np.ascontiguousarray(confidence, np.float32),
            np.ascontiguousarray(intrinsics, np.float64),
            np.ascontiguousarray(world_from_camera, np.float64),
        )
        votes = self._supporting, self._seen_through, self.best_cosine

        def add_to(part: slice) -> None:
            vertices, normals = self._mesh.vertices[part], self._mesh.normals[part]
            _add_votes(vertices, normals, *view, *(of_all[part] for of_all in votes))

        count = len(self._mesh.vertices)
        parts = [slice(count)] if count < FEW else [slice(count // 2), slice(count // 2, count)]
        side_by_side(add_to, parts)  # no vertex is in two

    def supported_faces(self) -> SurfaceMesh:
        """The mesh of those faces whose three vertices pass both thresholds."""
        good = (self.best_cosine >= np.cos(np.radians(MAX_ANGLE_DEG))) & (self.contradiction <= MAX_CONTRADICTION)
        return self._mesh.with_faces(good[self._mesh.faces].all(axis=1))


@compiled
def _add_votes(
    vertices: Array,
    normals: Array,
    depth: Image,
    nearest: Image,
    confidence: Image,
    intrinsics: Array,
    world_from_camera: Array,
    supporting: Array,
    seen_through: Array,
    best_cosine: Array,
) -> None:
    """One keyframe's votes on the vertices that lie in its picture: the last three (V,) are changed in place.

    nearest (H,W): least depth in each 3x3 window. Reprojection may miss a fold's crest by a pixel: a vertex is seen
    through only if all nine pixels look past it.
    """
    height, width = depth.shape
    centre, local, normal, pixel = world_from_camera[:3, 3], np.zeros(3), np.zeros(3), np.zeros(3)
    for vertex in range(len(vertices)):
        for j in range(3):
            local[j] = normal[j] = 0.0
            for i in range(3):
                local[j] += (vertices[vertex, i] - centre[i]) * world_from_camera[i, j]
                normal[j] += normals[vertex, i] * world_from_camera[i, j]
        if not local[2] > 0:
            continue
        for i in range(3):
            pixel[i] = intrinsics[i, 0] * local[0] + intrinsics[i, 1] * local[1] + intrinsics[i, 2] * local[2]
        x, y = np.floor(pixel[0] / pixel[2]), np.floor(pixel[1] / pixel[2])
        if not (0 <= x < width and 0 <= y < height):
            continue
        row, column = int(y), int(x)
        weight = confidence[row, column]
        if not (depth[row, column] > 0 and weight > 0):
            continue
        tolerance = DEPTH_TOLERANCE * local[2]
        if nearest[row, column] - local[2] > tolerance:
            seen_through[vertex] += weight
        if abs(depth[row, column] - local[2]) <= tolerance:
            supporting[vertex] += weight
            along = local[0] * normal[0] + local[1] * normal[1] + local[2] * normal[2]
            distance = np.sqrt(local[0] ** 2 + local[1] ** 2 + local[2] ** 2)
            best_cosine[vertex] = max(best_cosine[vertex], -along / distance)


def _nearest_around(depth: Image) -> Image:
    """Least known depth in each 3x3 window (H,W); infinite where a window holds none."""
    known = np.where(depth > 0, depth, np.float32(np.inf))
    return np.asarray(cv2.erode(known, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE), np.float32)
