"""Which parts of a fused surface its own depth maps bear out: seen square enough by one, looked through by few.

A network that completes depth bridges the step at a fold's rim with a ramp. Seen from where it arose, a ramp runs
along the rays; and other frames, which look past the rim, see through it. Real wall behind the fold is neither.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from reconstruction.mesh.surface_mesh import SurfaceMesh

Array = NDArray[np.float64]

AGREEMENT = 0.05  # of the depth; a map that puts its surface within this of a vertex has seen it
BEST_ANGLE_DEG = 70.0  # between ray and normal: wall that no frame saw squarer is not believed
MOST_CONTRADICTION = 0.2  # share of the confidence of those frames that saw a vertex or through it
# Both were chosen on runs of two films, of seeds 11 and 12; docs/lab/coverage.md marks their figures as not held out.


class SurfaceWitness:
    """Shows every keyframe's depth to the vertices of a mesh; all lengths in one unit."""

    def __init__(self, mesh: SurfaceMesh) -> None:
        self._mesh = mesh
        count = len(mesh.vertices)
        self.best_cosine = np.zeros(count)  # between normal and ray, of the frames that saw the vertex
        self._seen = np.zeros(count)  # sums of confidence
        self._through = np.zeros(count)

    @property
    def contradiction(self) -> Array:
        """(V,) share of the witnesses, by confidence, that saw through the vertex; 1 where there are none."""
        total = self._seen + self._through
        return np.divide(self._through, total, out=np.ones_like(total), where=total > 0)

    def add(
        self, depth: NDArray[np.float32], confidence: NDArray[np.float32], intrinsics: Array, world_from_camera: Array
    ) -> None:
        """A keyframe: z-depth (H,W), 0 = none; confidence (H,W); `intrinsics` with pixel centres at half integers."""
        rotation, centre = world_from_camera[:3, :3], world_from_camera[:3, 3]
        points = (self._mesh.vertices - centre) @ rotation
        ahead = np.flatnonzero(points[:, 2] > 0)
        pixel = points[ahead] @ intrinsics.T
        column, row = np.floor(pixel[:, :2] / pixel[:, 2:]).astype(np.int64).T
        height, width = depth.shape
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        vertex, row, column = ahead[inside], row[inside], column[inside]
        weight = confidence[row, column] * (depth[row, column] > 0)
        slack = AGREEMENT * points[vertex, 2]
        seen = (np.abs(depth[row, column] - points[vertex, 2]) <= slack) & (weight > 0)
        self._seen[vertex] += weight * seen
        # A fold's crest is never met to the pixel: only what every pixel around looks past was looked through.
        self._through[vertex] += weight * (_nearest_around(depth)[row, column] - points[vertex, 2] > slack)
        ray = points[vertex[seen]]
        normal = self._mesh.normals[vertex[seen]] @ rotation
        cosine = -np.einsum("ni,ni->n", ray, normal) / np.linalg.norm(ray, axis=1)
        self.best_cosine[vertex[seen]] = np.maximum(self.best_cosine[vertex[seen]], cosine)

    def believed(self) -> SurfaceMesh:
        """The mesh without the faces that have a corner which the depth maps do not bear out."""
        good = (self.best_cosine >= np.cos(np.radians(BEST_ANGLE_DEG))) & (self.contradiction <= MOST_CONTRADICTION)
        return self._mesh.with_faces(good[self._mesh.faces].all(axis=1))


def _nearest_around(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Least known depth in each 3x3 window (H,W); infinite where a window holds none."""
    known = np.where(depth > 0, depth, np.float32(np.inf))
    return np.asarray(cv2.erode(known, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE), np.float32)
