"""What wall the holes of a lumen's mesh may hide: a smooth closing of it, to measure holes by and never to show.

Where a mesh ends there is a frontier between what was seen and what was not. The smoothest closed surface through the
seen wall and its normals (Kazhdan and Hoppe, "Screened Poisson surface reconstruction", TOG 2013) crosses every
frontier, bulges behind folds the way their seen flanks point, and so has about the area of the hidden wall; a flat lid
over the hole would miss the pocket behind a fold. Each of its triangles is *seen* if the nearest point of the mesh is
inside the mesh, and *unseen* if it is on the mesh's boundary: the frontier itself decides, not visibility from the
middle of the lumen. Both kinds are measured on the same smooth surface, so that a noisy mesh does not count more wall
where it is seen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from haustra.core.sim3 import scale_of
from reconstruction.coverage.centreline import Centreline, NotATube
from reconstruction.coverage.visibility import FieldOfView, VisibilityLimits, visible_points
from reconstruction.mesh.open3d_import import import_open3d, ray_scene
from reconstruction.mesh.surface_mesh import SurfaceMesh

Array = NDArray[np.float64]

# Lengths are shares of the lumen's radius.
CELL = 0.06  # of the octree; 1.4 mm in a colon. Half of it changes coverage by 0.1 points and costs four times the time
LONGEST_EDGE = 0.08  # of the closing, which is coarse where it crosses a hole
MARGIN = 1.5  # of mesh beyond the stretch, so that the closing's own ends lie outside it
FARTHEST = 3.0  # from the centreline
STRAY = 0.15  # a closing farther from the mesh than this follows none of it
POISSON_SCALE = 1.1  # cube of the octree over the samples' bounding cube
DEEPEST = 11  # levels of the octree
FEWEST_FACES = 100  # of a mesh that can be judged
# Between ray and normal: wall that no camera sees squarer is not in plain view. The normal is the closing's guess, so
# more is asked than of wall that was measured.
SQUARE_DEG = 60.0
IN_SIGHT = 5.0  # nor is wall that is farther: down the lumen, too much that stands between may be missing in the mesh
BEHIND = 1.0  # nor is what cameras look through, if they meet wall so far behind it
APART = 0.05  # of two cameras that count as two
SLACK = 0.03  # the closing runs so far off the mesh that it continues, which must not stand in its way


@dataclass(frozen=True)
class Closure:
    """Triangles of the closing within the stretch, in the mesh's axes and unit."""

    vertices: Array  # (V,3)
    faces: NDArray[np.int64]  # (F,3), normals towards the lumen
    unseen: NDArray[np.bool_]  # (F,) neither in the mesh nor in plain view
    arc: Array  # (F,) of the faces' centroids
    angle: Array  # (F,)
    unmeasured: NDArray[np.bool_]  # (F,) in plain view, so seen, but not in the mesh

    def transformed(self, target_from_mesh: Array) -> Closure:
        """The same closing moved by a Sim(3), given as 4x4 with scale times rotation in its upper left."""
        linear = target_from_mesh[:3, :3]
        vertices = self.vertices @ linear.T + target_from_mesh[:3, 3]
        return replace(self, vertices=vertices, arc=float(scale_of(linear)) * self.arc)

    def part(self, kept: NDArray[np.bool_]) -> Closure:
        """Only the triangles of the mask (F,)."""
        rows = {name: getattr(self, name)[kept] for name in ("faces", "unseen", "arc", "angle", "unmeasured")}
        return replace(self, **rows)

    def seen_by(self, mesh: SurfaceMesh, poses: Array, field_of_view: FieldOfView, radius: float) -> Closure:
        """The same closing where what is in plain view of cameras (N,4,4) counts as seen, though it is not in the
        mesh, which alone stands in the way. `radius` is the lumen's."""
        rows = np.flatnonzero(self.unseen)
        normals, centroids = self.surface.face_normals[rows], self.centroids[rows]
        lengths = (length * radius for length in (IN_SIGHT, SLACK, BEHIND, APART))
        limits = VisibilityLimits(float(np.cos(np.radians(SQUARE_DEG))), *lengths)
        seen = visible_points(centroids, normals, mesh, poses, field_of_view, limits)
        visible = rows[seen]
        unseen, unmeasured = self.unseen.copy(), self.unmeasured.copy()
        unseen[visible], unmeasured[visible] = False, True
        return replace(self, unseen=unseen, unmeasured=unmeasured)

    @property
    def centroids(self) -> Array:
        return self.vertices[self.faces].mean(axis=1)

    @property
    def surface(self) -> SurfaceMesh:
        return SurfaceMesh.from_triangles(self.vertices, self.faces)

    @property
    def areas(self) -> Array:
        """(F,)"""
        return self.surface.face_areas


def close_wall(
    mesh: SurfaceMesh, line: Centreline, stretch: tuple[float, float], radius: float, fringe: float = 0.0
) -> Closure:
    """Close the mesh between two arc lengths. Raises `NotATube` where there is too little of it to close.

    Wall up to `fringe` past the mesh's boundary still counts as seen.
    """
    arc, _, off = line.locate(mesh.vertices)
    low, high = stretch
    near = (arc > low - MARGIN * radius) & (arc < high + MARGIN * radius) & (off < FARTHEST * radius)
    part = mesh.with_faces(np.all(near[mesh.faces], axis=1, keepdims=False))
    if len(part.faces) < FEWEST_FACES:
        raise NotATube(f"only {len(part.faces)} triangles lie along the camera's path, too few to judge")
    vertices, faces = _subdivided(*_poisson(part, CELL * radius), LONGEST_EDGE * radius)
    centroid = vertices[faces].mean(axis=1)
    arc, angle, off = line.locate(centroid)
    inside = (arc >= low) & (arc <= high) & (off < FARTHEST * radius)
    inside &= SurfaceMesh.from_triangles(vertices, faces).face_areas > 0  # a region of nothing else has no middle
    vertices, faces, arc, angle = vertices, faces[inside], arc[inside], angle[inside]
    unseen = _beyond_the_frontier(part, centroid[inside], fringe, STRAY * radius)
    kept = _pieces_with_wall(faces, unseen)
    surface = SurfaceMesh.from_triangles(vertices, faces).with_faces(kept)
    return Closure(
        surface.vertices, surface.faces, unseen[kept], arc[kept], angle[kept], np.zeros(len(surface.faces), bool)
    )


def _poisson(mesh: SurfaceMesh, cell: float) -> tuple[Array, NDArray[np.int64]]:
    """Vertices and faces of the closing with normals as the mesh's. One thread, so that runs agree to the bit."""
    o3d = import_open3d()
    points, normals = _thinned(mesh, cell)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.normals = o3d.utility.Vector3dVector(normals)
    extent = POISSON_SCALE * float(np.ptp(points, axis=0).max())
    depth = int(np.clip(np.ceil(np.log2(extent / cell)), 5, DEEPEST))
    closed, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
        cloud, depth=depth, scale=POISSON_SCALE, n_threads=1
    )
    return np.asarray(closed.vertices), np.asarray(closed.triangles).astype(np.int64)


def _thinned(mesh: SurfaceMesh, cell: float) -> tuple[Array, Array]:
    """Mean position and normal of the vertices in each cube that face the same way (by the normal's longest axis), so
    that the two sides of a thin fold stay apart."""
    way = 2 * np.abs(mesh.normals).argmax(axis=1)
    way += np.take_along_axis(mesh.normals, way[:, None] // 2, axis=1)[:, 0] > 0
    cube = np.column_stack([np.floor(mesh.vertices / cell).astype(np.int64), way])
    _, owner, count = np.unique(cube, axis=0, return_inverse=True, return_counts=True)
    sums = np.zeros((len(count), 6))
    np.add.at(sums, owner.ravel(), np.hstack([mesh.vertices, mesh.normals]))
    normals = sums[:, 3:] / np.maximum(np.linalg.norm(sums[:, 3:], axis=1, keepdims=True), 1e-12)
    return sums[:, :3] / count[:, None], normals


def _subdivided(vertices: Array, faces: NDArray[np.int64], longest: float) -> tuple[Array, NDArray[np.int64]]:
    """The same surface with no edge longer than `longest`."""
    import trimesh

    parted, pieces = trimesh.remesh.subdivide_to_size(vertices, faces, longest, max_iter=20)
    merged = trimesh.Trimesh(parted, pieces, process=False)
    merged.merge_vertices()
    return np.asarray(merged.vertices), np.asarray(merged.faces).astype(np.int64)


def _beyond_the_frontier(mesh: SurfaceMesh, points: Array, fringe: float, stray: float) -> NDArray[np.bool_]:
    """Whether the mesh's nearest point to each of `points` (N,3) lies on its boundary and farther than `fringe`, or
    anywhere and farther than `stray`."""
    o3d = import_open3d()
    scene = ray_scene(mesh.vertices, mesh.faces)
    answer = scene.compute_closest_points(o3d.core.Tensor(points.astype(np.float32)))
    face = answer["primitive_ids"].numpy().astype(np.int64)
    u, v = answer["primitive_uvs"].numpy().T
    # Corner weights of the nearest point: on the edge opposite to a corner that corner's weight is nothing.
    weights = np.stack([1 - u - v, u, v], axis=1)
    on_boundary = ((weights < 1e-3) & boundary_sides(mesh.faces)[face]).any(axis=1)
    distance = np.linalg.norm(answer["points"].numpy() - points, axis=1)
    return (on_boundary & (distance > fringe)) | (distance > stray)


def boundary_sides(faces: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(F,3): whether the edge opposite to each corner belongs to this face alone."""
    edges = np.sort(faces[:, [[1, 2], [2, 0], [0, 1]]], axis=2).reshape(-1, 2)
    key = edges[:, 0] * (int(faces.max(initial=0)) + 1) + edges[:, 1]
    _, owner, count = np.unique(key, return_inverse=True, return_counts=True)
    return (count[owner] == 1).reshape(-1, 3)


def _pieces_with_wall(faces: NDArray[np.int64], unseen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(F,) faces of connected pieces that hold some seen wall: a bubble of the closing elsewhere is nothing."""
    piece = connected_faces(faces)
    return (np.bincount(piece, weights=~unseen) > 0)[piece]


def connected_faces(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number (F,) of the piece each face belongs to; faces that share a vertex are connected."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not len(faces):
        return np.empty(0, np.int64)
    names, compact = np.unique(faces, return_inverse=True)
    compact = compact.reshape(-1, 3)
    start, end = compact[:, :2].ravel(), compact[:, 1:].ravel()
    links = coo_array((np.ones(len(start), np.int8), (start, end)), shape=(len(names), len(names)))
    label = connected_components(links, directed=False)[1]
    return np.unique(label[compact[:, 0]], return_inverse=True)[1].reshape(-1)
