"""Hole closing: the area of wall that a mesh's holes may hide, on a screened Poisson surface through the observed wall.

The closed surface serves to measure holes and is never shown. The smoothest closed surface through the observed wall
and its normals (Kazhdan and Hoppe, "Screened Poisson surface reconstruction", TOG 2013) crosses every boundary of the
mesh, bulges behind folds the way their observed flanks point, and so has about the area of the hidden wall; a flat lid
would miss the pocket behind a fold. Each of its triangles is *observed* if the nearest point of the mesh is inside the
mesh, and *unobserved* if it is on the mesh's boundary; visibility from the lumen's middle does not enter. Both kinds
are measured on the same smooth surface, so that a noisy mesh does not count more wall where it is observed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from haustra.core.sim3 import scale_of
from reconstruction.coverage.centreline import Centreline, NotATube
from reconstruction.coverage.visibility import FieldOfView, VisibilityLimits, visible_points
from reconstruction.mesh.open3d_import import import_open3d, ray_scene
from reconstruction.mesh.surface_mesh import SurfaceMesh, boundary_sides, connected_faces

Array = NDArray[np.float64]

# Lengths are in lumen radii.
CELL = 0.06  # edge of an octree cell; 1.4 mm in a colon. Half of it: 0.1 points of coverage, four times the time
MAX_EDGE = 0.08  # of the closed surface's triangles, which Poisson leaves coarse across a hole
MARGIN = 1.5  # of mesh beyond either end of the stretch, so that the closed surface's own ends lie outside it
MAX_OFF_LINE = 3.0  # distance from the centreline beyond which a surface is no wall of this lumen
MAX_DISTANCE = 0.15  # from the mesh, above which a triangle of the closed surface counts as unobserved anyhow
POISSON_SCALE = 1.1  # cube of the octree over the samples' bounding cube
MAX_DEPTH = 11  # levels of the octree
MIN_FACES = 100  # of the mesh within the stretch, below which it is not judged
# Limits of visibility of unobserved wall. Its normal is extrapolated, so the angle is stricter than for measured wall.
MAX_VIEW_ANGLE_DEG = 60.0  # between ray and normal
MAX_VIEW_DISTANCE = 5.0  # from the camera; farther down the lumen, too much that occludes may be missing in the mesh
SEE_THROUGH_DEPTH = 1.0  # behind the point, up to which a camera-facing hit means that the camera sees through a hole
MIN_BASELINE = 0.05  # above which two cameras count as two
OCCLUSION_TOLERANCE = 0.03  # the closed surface runs so far off the mesh that it continues, which must not occlude it


@dataclass(frozen=True)
class ClosedWall:
    """Triangles of the hole-closed surface within the stretch, in the mesh's axes and unit."""

    vertices: Array  # (V,3)
    faces: NDArray[np.int64]  # (F,3), normals towards the lumen
    unobserved: NDArray[np.bool_]  # (F,) neither in the mesh nor visible to cameras
    arc: Array  # (F,) arc length of the faces' centroids
    angle: Array  # (F,) rad, about the centreline
    unmeasured: NDArray[np.bool_]  # (F,) visible, so observed, but not in the mesh
    distance: Array  # (F,) of the faces' centroids from the mesh

    def transformed(self, target_from_mesh: Array) -> ClosedWall:
        """A copy moved by a Sim(3), given as (4,4) with scale times rotation in its upper left."""
        linear = target_from_mesh[:3, :3]
        vertices, scale = self.vertices @ linear.T + target_from_mesh[:3, 3], float(scale_of(linear))
        return replace(self, vertices=vertices, arc=scale * self.arc, distance=scale * self.distance)

    def with_faces(self, kept: NDArray[np.bool_]) -> ClosedWall:
        """A copy with the triangles where `kept` (F,) is true."""
        names = ("faces", "unobserved", "arc", "angle", "unmeasured", "distance")
        return replace(self, **{name: getattr(self, name)[kept] for name in names})

    def with_visible(
        self, mesh: SurfaceMesh, world_from_camera: Array, field_of_view: FieldOfView, radius: float
    ) -> ClosedWall:
        """A copy in which unobserved faces visible to the cameras (N,4,4) become observed but unmeasured.

        `mesh` alone occludes; `radius` is the lumen's.
        """
        rows = np.flatnonzero(self.unobserved)
        normals, centroids = self.surface.face_normals[rows], self.centroids[rows]
        lengths = (MAX_VIEW_DISTANCE, OCCLUSION_TOLERANCE, SEE_THROUGH_DEPTH, MIN_BASELINE)
        limits = VisibilityLimits(
            float(np.cos(np.radians(MAX_VIEW_ANGLE_DEG))), *(length * radius for length in lengths)
        )
        visible = rows[visible_points(centroids, normals, mesh, world_from_camera, field_of_view, limits)]
        unobserved, unmeasured = self.unobserved.copy(), self.unmeasured.copy()
        unobserved[visible], unmeasured[visible] = False, True
        return replace(self, unobserved=unobserved, unmeasured=unmeasured)

    @property
    def centroids(self) -> Array:
        """(F,3)"""
        return self.vertices[self.faces].mean(axis=1)

    @property
    def surface(self) -> SurfaceMesh:
        return SurfaceMesh.from_triangles(self.vertices, self.faces)

    @property
    def areas(self) -> Array:
        """(F,) in squared units."""
        return self.surface.face_areas


def close_holes(
    mesh: SurfaceMesh, line: Centreline, stretch: tuple[float, float], radius: float, edge_tolerance: float = 0.0
) -> ClosedWall:
    """Hole-closed surface of the mesh between the two arc lengths of `stretch`; `radius` is the lumen's.

    Wall up to `edge_tolerance` (mesh unit) past the mesh's boundary still counts as observed. Raises `NotATube` where
    the stretch holds fewer than MIN_FACES triangles.
    """
    arc, _, off = line.locate(mesh.vertices)
    low, high = stretch
    near = (arc > low - MARGIN * radius) & (arc < high + MARGIN * radius) & (off < MAX_OFF_LINE * radius)
    part = mesh.with_faces(np.all(near[mesh.faces], axis=1, keepdims=False))
    if len(part.faces) < MIN_FACES:
        raise NotATube(f"only {len(part.faces)} triangles lie along the camera's path, too few to judge")
    vertices, faces = _subdivided(*_poisson(part, CELL * radius), MAX_EDGE * radius)
    centroid = vertices[faces].mean(axis=1)
    arc, angle, off = line.locate(centroid)
    inside = (arc >= low) & (arc <= high) & (off < MAX_OFF_LINE * radius)
    inside &= SurfaceMesh.from_triangles(vertices, faces).face_areas > 0  # a region of such faces alone has no centroid
    vertices, faces, arc, angle = vertices, faces[inside], arc[inside], angle[inside]
    unobserved, distance = _beyond_boundary(part, centroid[inside], edge_tolerance, MAX_DISTANCE * radius)
    kept = _pieces_with_observed(faces, unobserved)
    surface = SurfaceMesh.from_triangles(vertices, faces).with_faces(kept)
    return ClosedWall(
        surface.vertices,
        surface.faces,
        unobserved[kept],
        arc[kept],
        angle[kept],
        np.zeros(len(surface.faces), bool),
        distance[kept],
    )


def _poisson(mesh: SurfaceMesh, cell: float) -> tuple[Array, NDArray[np.int64]]:
    """Screened Poisson surface of the mesh: vertices (V,3), faces (F,3). One thread, so that runs agree to the bit."""
    o3d = import_open3d()
    points, normals = _oriented_samples(mesh, cell)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.normals = o3d.utility.Vector3dVector(normals)
    extent = POISSON_SCALE * float(np.ptp(points, axis=0).max())
    depth = int(np.clip(np.ceil(np.log2(extent / cell)), 5, MAX_DEPTH))
    closed, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
        cloud, depth=depth, scale=POISSON_SCALE, n_threads=1
    )
    return np.asarray(closed.vertices), np.asarray(closed.triangles).astype(np.int64)


def _oriented_samples(mesh: SurfaceMesh, cell: float) -> tuple[Array, Array]:
    """Samples of the mesh for Poisson: one position (K,3) and unit normal (K,3) per cube of edge `cell` and direction.

    Vertices are averaged only with those that face the same way (signed longest axis of the normal), so that the two
    sides of a thin fold stay apart.
    """
    way = 2 * np.abs(mesh.normals).argmax(axis=1)
    way += np.take_along_axis(mesh.normals, way[:, None] // 2, axis=1)[:, 0] > 0
    cube = np.column_stack([np.floor(mesh.vertices / cell).astype(np.int64), way])
    _, owner, count = np.unique(cube, axis=0, return_inverse=True, return_counts=True)
    sums = np.zeros((len(count), 6))
    np.add.at(sums, owner.ravel(), np.hstack([mesh.vertices, mesh.normals]))
    normals = sums[:, 3:] / np.maximum(np.linalg.norm(sums[:, 3:], axis=1, keepdims=True), 1e-12)
    return sums[:, :3] / count[:, None], normals


def _subdivided(vertices: Array, faces: NDArray[np.int64], max_edge: float) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (V,3) and faces (F,3) of the same surface with no edge longer than `max_edge`."""
    import trimesh

    parted, pieces = trimesh.remesh.subdivide_to_size(vertices, faces, max_edge, max_iter=20)
    merged = trimesh.Trimesh(parted, pieces, process=False)
    merged.merge_vertices()
    return np.asarray(merged.vertices), np.asarray(merged.faces).astype(np.int64)


def _beyond_boundary(
    mesh: SurfaceMesh, points: Array, edge_tolerance: float, max_distance: float
) -> tuple[NDArray[np.bool_], Array]:
    """(N,) whether the mesh's point nearest to each of `points` (N,3) is on its boundary and farther than
    `edge_tolerance`, or anywhere and farther than `max_distance`; and its distance (N,)."""
    o3d = import_open3d()
    scene = ray_scene(mesh.vertices, mesh.faces)
    answer = scene.compute_closest_points(o3d.core.Tensor(points.astype(np.float32)))
    face = answer["primitive_ids"].numpy().astype(np.int64)
    u, v = answer["primitive_uvs"].numpy().T
    # Barycentric weights of the nearest point: on the edge opposite to a corner that corner's weight is 0.
    weights = np.stack([1 - u - v, u, v], axis=1)
    on_boundary = ((weights < 1e-3) & boundary_sides(mesh.faces)[face]).any(axis=1)
    distance = np.linalg.norm(answer["points"].numpy() - points, axis=1)
    return (on_boundary & (distance > edge_tolerance)) | (distance > max_distance), distance


def _pieces_with_observed(faces: NDArray[np.int64], unobserved: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(F,) faces of connected pieces with at least one observed face: Poisson's bubbles elsewhere are no wall."""
    piece = connected_faces(faces)
    return (np.bincount(piece, weights=~unobserved) > 0)[piece]
