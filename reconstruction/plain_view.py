"""Which places of a wall stood in plain view of a camera: in its picture, turned towards it, with nothing in between.

A surface is fused only where depth is sure and several frames agree. Beside and behind the rims of folds neither is
so, though the camera looks at the wall there: it was not missed, it was not measured. Poses and the surface that stands
in the way tell the two apart without asking the depth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reconstruction.mesh import SurfaceMesh
from reconstruction.open3d_import import import_open3d

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Picture:
    """What every frame of a camera shows, through its own lens: a rectified picture may have lost its corners."""

    project: Callable[[Array], Array]  # points in camera axes (N,3) -> pixels (N,2), NaN where the lens has none
    content: NDArray[np.bool_]  # (H,W): pixels that show the scene, not the border of the picture

    def shows(self, points: Array) -> NDArray[np.bool_]:
        """(N,): whether each point, in camera axes (N,3), lies on a pixel that shows the scene."""
        place = np.floor(self.project(points))
        height, width = self.content.shape
        on: NDArray[np.bool_] = np.asarray(((place >= 0) & (place < (width, height))).all(axis=1))
        column, row = np.where(on[:, None], place, 0).astype(np.int64).T
        return on & self.content[row, column]


def in_plain_view(
    points: Array,
    normals: Array,
    blocking: SurfaceMesh,
    world_from_camera: Array,
    picture: Picture,
    least_cosine: float,
    farthest: float,
    slack: float,
) -> NDArray[np.bool_]:
    """(N,): whether any camera (M,4,4) has the point (N,3) in its picture and at most `farthest` away, with at least
    `least_cosine` between the unit normal (N,3) and the ray back, and no surface on the ray that is farther than
    `slack` before the point."""
    from scipy.spatial import cKDTree

    o3d = import_open3d()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(blocking.vertices.astype(np.float32)), o3d.core.Tensor(blocking.faces.astype(np.uint32))
    )
    visible = np.zeros(len(points), bool)
    if not len(points):
        return visible
    tree = cKDTree(points)
    for pose in world_from_camera:
        near = np.array(tree.query_ball_point(pose[:3, 3], farthest, return_sorted=True), np.int64)
        near = near[~visible[near]]
        ray = points[near] - pose[:3, 3]
        distance = np.linalg.norm(ray, axis=1)
        good = -np.einsum("ni,ni->n", normals[near], ray) >= least_cosine * distance
        good[good] = picture.shows(ray[good] @ pose[:3, :3])
        near, ray, distance = near[good], ray[good], distance[good]
        if len(near):
            rays = np.hstack([np.broadcast_to(pose[:3, 3], ray.shape), ray / distance[:, None]]).astype(np.float32)
            met = scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
            visible[near[met > distance - slack]] = True
    return visible
