"""Which places of a wall stood in plain view of a camera: in its picture, turned towards it, with nothing in between.

A surface is fused only where depth is sure and several frames agree. Beside and behind the rims of folds neither is
so, though the camera looks at the wall there: it was not missed, it was not measured. Poses and the surface that stands
in the way tell the two apart without asking the depth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from reconstruction.mesh import SurfaceMesh
from reconstruction.open3d_import import import_open3d

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Picture:
    """What every frame of a pinhole camera shows."""

    intrinsics: Array  # (3,3), pixel centres at half integers
    content: NDArray[np.bool_]  # (H,W): pixels that show the scene, not the border of the picture
    farthest: float  # z-depth beyond which nothing is believed to be seen, in the mesh's unit

    def scaled(self, factor: float) -> Picture:
        """The same camera in a unit that is `1 / factor` of this one."""
        return replace(self, farthest=factor * self.farthest)


def in_plain_view(
    points: Array,
    normals: Array,
    blocking: SurfaceMesh,
    world_from_camera: Array,
    picture: Picture,
    least_cosine: float,
    slack: float,
) -> NDArray[np.bool_]:
    """(N,): whether any camera (M,4,4) has the point (N,3) in its picture, with at least `least_cosine` between the
    unit normal (N,3) and the ray back, and no surface on the ray that is farther than `slack` before the point."""
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
    corner = np.linalg.norm(_corner_ray(picture))  # how far a point of the greatest z-depth can be
    for pose in world_from_camera:
        near = np.array(tree.query_ball_point(pose[:3, 3], corner * picture.farthest), np.int64)
        near = near[~visible[near]]
        near = near[_in_picture(points[near], pose, picture)]
        ray = points[near] - pose[:3, 3]
        distance = np.linalg.norm(ray, axis=1)
        facing = -np.einsum("ni,ni->n", normals[near], ray) >= least_cosine * distance
        near, ray, distance = near[facing], ray[facing], distance[facing]
        if len(near):
            origin = np.broadcast_to(pose[:3, 3], ray.shape)
            rays = np.hstack([origin, ray / distance[:, None]]).astype(np.float32)
            met = scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
            visible[near[met > distance - slack]] = True
    return visible


def _corner_ray(picture: Picture) -> Array:
    """The longest ray of unit z-depth that the picture holds."""
    height, width = picture.content.shape
    corners = np.array([(x, y, 1.0) for x in (0, width) for y in (0, height)])
    rays = corners @ np.linalg.inv(picture.intrinsics).T
    return rays[np.argmax(np.linalg.norm(rays, axis=1))]


def _in_picture(points: Array, pose: Array, picture: Picture) -> NDArray[np.bool_]:
    """(N,): whether each point lies before the camera, near enough, on a pixel that shows the scene."""
    own = (points - pose[:3, 3]) @ pose[:3, :3]
    inside = (own[:, 2] > 0) & (own[:, 2] <= picture.farthest)
    pixel = own[inside] @ picture.intrinsics.T
    height, width = picture.content.shape
    place = np.floor(pixel[:, :2] / np.maximum(pixel[:, 2:], 1e-12))
    on = np.flatnonzero(((place >= 0) & (place < (width, height))).all(axis=1))
    column, row = place[on].astype(np.int64).T
    shown = np.flatnonzero(inside)[on[picture.content[row, column]]]
    return np.isin(np.arange(len(points)), shown)
