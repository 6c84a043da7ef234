"""Which places of a wall stood in plain view: in the pictures of cameras, turned towards them, with nothing in between.

A surface is fused only where depth is sure and several frames agree. Beside and behind the rims of folds neither is
so, though the camera looks at the wall there: it was not missed, it was not measured. Poses and the surface that stands
in the way, or behind, tell the two apart without asking the depth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.mesh.open3d_import import import_open3d, ray_scene
from reconstruction.mesh.surface_mesh import SurfaceMesh

Array = NDArray[np.float64]

FEWEST_VIEWS = 2  # one wrong pose must not show hidden wall
APART_DEG = 3.0


@dataclass(frozen=True)
class FieldOfView:
    """What every frame of a camera shows, through its own lens: a rectified picture may have lost its corners."""

    project: Callable[[Array], Array]  # points in camera axes (N,3) -> pixels (N,2), NaN where the lens has none
    content: NDArray[np.bool_]  # (H,W): pixels that show the scene, not the border of the picture

    def in_view(self, points: Array) -> NDArray[np.bool_]:
        """(N,): whether each point, in camera axes (N,3), lies on a pixel that shows the scene."""
        place = np.floor(self.project(points))
        height, width = self.content.shape
        on: NDArray[np.bool_] = np.asarray(((place >= 0) & (place < (width, height))).all(axis=1))
        column, row = np.where(on[:, None], place, 0).astype(np.int64).T
        return on & self.content[row, column]


@dataclass(frozen=True)
class Sight:
    """When a place is in plain view; lengths in the mesh's unit."""

    least_cosine: float  # between the wall's normal and the ray back to the camera
    farthest: float  # from the camera
    slack: float  # before the place, where a surface does not yet stand in the way
    behind: float  # the place, where a surface that faces the camera says that it looks through
    apart: float  # of two cameras that count as two


def in_plain_view(
    points: Array, normals: Array, wall: SurfaceMesh, world_from_camera: Array, field_of_view: FieldOfView, sight: Sight
) -> NDArray[np.bool_]:
    """(N,): whether places (N,3) of unit normals (N,3) are in the picture of two cameras (M,4,4) or more, with no
    `wall` between them, and whether fewer than half of those cameras meet `wall` behind the place instead: there they
    look into the mouth of a pocket, not at wall. Of cameras that hardly moved, one counts."""
    from scipy.spatial import cKDTree

    views, through = np.zeros(len(points), np.int64), np.zeros(len(points), np.int64)
    if not len(points):
        return views > 0
    scene, tree = ray_scene(wall.vertices, wall.faces), cKDTree(points)
    for pose in distinct(world_from_camera, sight.apart, APART_DEG):
        near = np.array(tree.query_ball_point(pose[:3, 3], sight.farthest, return_sorted=True), np.int64)
        ray = points[near] - pose[:3, 3]
        distance = np.linalg.norm(ray, axis=1)
        good = -np.einsum("ni,ni->n", normals[near], ray) >= sight.least_cosine * distance
        good[good] = field_of_view.in_view(ray[good] @ pose[:3, :3])
        near, ray, distance = near[good], ray[good] / distance[good, None], distance[good]
        met, _ = _cast(scene, np.broadcast_to(pose[:3, 3], ray.shape), ray)
        free = met > distance - sight.slack
        near, ray = near[free], ray[free]
        views[near] += 1
        met, facing = _cast(scene, points[near] - sight.slack * ray, ray)
        through[near] += (met < sight.slack + sight.behind) & facing
    return (views >= FEWEST_VIEWS) & (2 * through < views)


def distinct(world_from_camera: Array, apart: float, apart_deg: float) -> Array:
    """Of cameras (M,4,4) in the order of the film, the first, and each that moved or turned on since the last."""
    kept = [0]
    for number in range(1, len(world_from_camera)):
        here, last = world_from_camera[number], world_from_camera[kept[-1]]
        turn = (np.trace(here[:3, :3].T @ last[:3, :3]) - 1) / 2
        if np.linalg.norm(here[:3, 3] - last[:3, 3]) > apart or turn < np.cos(np.radians(apart_deg)):
            kept.append(number)
    return world_from_camera[kept]


def _cast(scene: Any, origin: Array, ray: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Distance (N,) along unit rays to the first surface, infinite where there is none, and whether it faces them."""
    if not len(ray):
        return np.zeros(0), np.zeros(0, bool)
    o3d = import_open3d()
    answer = scene.cast_rays(o3d.core.Tensor(np.hstack([origin, ray]).astype(np.float32)))
    facing = np.einsum("ni,ni->n", answer["primitive_normals"].numpy(), ray) < 0
    return answer["t_hit"].numpy().astype(np.float64), facing
