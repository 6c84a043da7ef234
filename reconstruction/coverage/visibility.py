"""Visibility of wall points from posed cameras: in the field of view, facing the camera, not occluded.

A surface is fused only where depth is confident and several frames agree. Beside and behind the rims of folds this
fails although the camera looks at the wall there: such wall was observed, but not measured. Visibility from the poses
and the surface that may occlude the wall, or lie behind it, tells observed from missed wall without using the depth.
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

MIN_VIEWS = 2  # cameras from which a point must be visible: one wrong pose must not show hidden wall
MIN_TURN_DEG = 3.0  # rotation above which two cameras at one place count as two


@dataclass(frozen=True)
class FieldOfView:
    """Pixels on which a camera sees the scene, through its own lens: a rectified image may have lost its corners."""

    project: Callable[[Array], Array]  # points in camera axes (N,3) -> pixels (N,2), NaN outside the lens model
    content: NDArray[np.bool_]  # (H,W): pixels that show the scene, not the border of the image

    def in_view(self, points: Array) -> NDArray[np.bool_]:
        """(N,): whether each point, in camera axes (N,3), projects to a pixel of `content`."""
        pixel = np.floor(self.project(points))
        height, width = self.content.shape
        on: NDArray[np.bool_] = np.asarray(((pixel >= 0) & (pixel < (width, height))).all(axis=1))
        column, row = np.where(on[:, None], pixel, 0).astype(np.int64).T
        return on & self.content[row, column]


@dataclass(frozen=True)
class VisibilityLimits:
    """Thresholds of visibility; lengths in the mesh's unit."""

    min_cosine: float  # between the wall's normal and the ray back to the camera
    max_distance: float  # from the camera
    occlusion_tolerance: float  # a hit nearer to the point than this does not occlude it
    see_through_depth: float  # a camera-facing hit at most this far behind the point: the camera sees through a hole
    min_baseline: float  # distance above which two cameras count as two


def visible_points(
    points: Array,
    normals: Array,
    wall: SurfaceMesh,
    world_from_camera: Array,
    field_of_view: FieldOfView,
    limits: VisibilityLimits,
) -> NDArray[np.bool_]:
    """(N,): whether points (N,3) of unit normals (N,3) are visible from MIN_VIEWS of the cameras (M,4,4) or more.

    `wall` occludes. A point that half or more of those cameras see through, meeting `wall` behind it, is the mouth of
    a pocket and not visible wall. Of consecutive cameras that hardly moved, one counts.
    """
    from scipy.spatial import cKDTree

    views, see_through = np.zeros(len(points), np.int64), np.zeros(len(points), np.int64)
    if not len(points):
        return views > 0
    scene, tree = ray_scene(wall.vertices, wall.faces), cKDTree(points)
    for camera in distinct_cameras(world_from_camera, limits.min_baseline, MIN_TURN_DEG):
        rows, ray, distance = _in_view(points, normals, tree, camera, field_of_view, limits)
        hit, _ = _cast(scene, np.broadcast_to(camera[:3, 3], ray.shape), ray)
        free = hit > distance - limits.occlusion_tolerance
        rows, ray = rows[free], ray[free]
        views[rows] += 1
        hit, facing = _cast(scene, points[rows] - limits.occlusion_tolerance * ray, ray)
        see_through[rows] += (hit < limits.occlusion_tolerance + limits.see_through_depth) & facing
    return (views >= MIN_VIEWS) & (2 * see_through < views)


def _in_view(
    points: Array,
    normals: Array,
    tree: Any,
    world_from_camera: Array,
    field_of_view: FieldOfView,
    limits: VisibilityLimits,
) -> tuple[NDArray[np.int64], Array, Array]:
    """Rows (K,) of the points near enough, facing and in view of one camera (4,4); unit rays (K,3), distances (K,)."""
    centre = world_from_camera[:3, 3]
    rows = np.array(tree.query_ball_point(centre, limits.max_distance, return_sorted=True), np.int64)
    ray = points[rows] - centre
    distance = np.linalg.norm(ray, axis=1)
    good = -np.einsum("ni,ni->n", normals[rows], ray) >= limits.min_cosine * distance
    good[good] = field_of_view.in_view(ray[good] @ world_from_camera[:3, :3])
    return rows[good], ray[good] / distance[good, None], distance[good]


def distinct_cameras(world_from_camera: Array, min_baseline: float, min_turn_deg: float) -> Array:
    """Some of the cameras (M,4,4), in the order of the video: the first, and each that moved or turned on since the
    last kept."""
    kept = [0]
    for number in range(1, len(world_from_camera)):
        here, last = world_from_camera[number], world_from_camera[kept[-1]]
        cosine = (np.trace(here[:3, :3].T @ last[:3, :3]) - 1) / 2
        moved = np.linalg.norm(here[:3, 3] - last[:3, 3]) > min_baseline
        if moved or cosine < np.cos(np.radians(min_turn_deg)):
            kept.append(number)
    return world_from_camera[kept]


def _cast(scene: Any, origin: Array, ray: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Distance (N,) along unit rays (N,3) to the first hit, infinite without one, and whether it faces the ray (N,)."""
    if not len(ray):
        return np.zeros(0), np.zeros(0, bool)
    o3d = import_open3d()
    answer = scene.cast_rays(o3d.core.Tensor(np.hstack([origin, ray]).astype(np.float32)))
    facing = np.einsum("ni,ni->n", answer["primitive_normals"].numpy(), ray) < 0
    return answer["t_hit"].numpy().astype(np.float64), facing
