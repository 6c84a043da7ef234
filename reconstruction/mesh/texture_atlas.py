"""Simplification within a stated error, and texture atlas: a light mesh that carries the fine mesh's colours.

Charts and their packing are xatlas's. Each texel's point on the light surface takes the colour of the fine mesh's
nearest vertices.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from haustra.core.errors import ReconstructionError
from reconstruction.mesh.decimation import decimated
from reconstruction.mesh.open3d_import import import_open3d, ray_scene
from reconstruction.mesh.surface_mesh import UNCOLOURED, SurfaceMesh
from reconstruction.mesh.textured_mesh import TexturedMesh

TEXELS_PER_EDGE = 1.5  # of the fine mesh's median edge: colours per vertex have no finer detail
FILL_RATIO = 0.5  # share of the texture that charts cover, roughly
MIN_SIDE, MAX_SIDE = 256, 4096  # px of a texture, which every viewer takes
GUTTER = 8  # px around charts that repeat their border, so that filtering shows no seam
MAX_HALVINGS = 5  # of the number of triangles
NEIGHBOURS = 3  # vertices of the fine mesh that colour a texel


def simplified(mesh: SurfaceMesh, max_error: float) -> tuple[SurfaceMesh, float]:
    """The mesh with its triangles halved as often as `max_error` allows, and its Hausdorff distance (mesh's unit).

    The distance is sampled both ways, at every vertex and at the middle of every edge and face. The mesh itself and 0
    where even half the triangles exceed `max_error`.
    """
    if not 0 < max_error < np.inf:
        raise ReconstructionError(f"the largest error must be a positive length, not {max_error}")
    best, error = mesh, 0.0
    for halving in range(1, MAX_HALVINGS + 1):
        candidate = decimated(mesh, len(mesh.faces) >> halving)
        if not len(candidate.faces):
            break
        distance = apart(mesh, candidate)
        if distance > max_error:
            break
        best, error = candidate, distance
    return best, error


def apart(first: SurfaceMesh, second: SurfaceMesh) -> float:
    """Sampled Hausdorff distance: of vertices, edges' and faces' middles of either mesh from the other's surface."""
    ways = ((first, second), (second, first))
    return max(float(distance_to_surface(_samples(one), other).max()) for one, other in ways)


def _samples(mesh: SurfaceMesh) -> NDArray[np.float64]:
    """Vertices, edges' middles and faces' middles (N,3)."""
    corners = mesh.vertices[mesh.faces]
    edges = (corners + np.roll(corners, -1, axis=1)) / 2
    return np.concatenate([mesh.vertices, edges.reshape(-1, 3), corners.mean(axis=1)])


def distance_to_surface(points: NDArray[np.float64], mesh: SurfaceMesh) -> NDArray[np.float64]:
    """Distance (N,) of points (N,3) to the nearest triangle of the mesh."""
    o3d = import_open3d()
    middle = mesh.vertices.mean(axis=0)  # Open3D computes in float32
    scene = ray_scene(mesh.vertices - middle, mesh.faces)
    return scene.compute_distance(o3d.core.Tensor((points - middle).astype(np.float32))).numpy().astype(np.float64)


def textured(light: SurfaceMesh, fine: SurfaceMesh) -> TexturedMesh:
    """`light` with a texture of the colours of `fine`, as fine as the vertices of `fine` are."""
    import xatlas

    if not len(light.faces) or not len(fine.vertices):
        raise ReconstructionError("a mesh without faces has nothing to lay a texture on")
    source, faces, uv = xatlas.parametrize(light.vertices.astype(np.float32), light.faces.astype(np.uint32))
    vertices, faces = light.vertices[source], faces.astype(np.int64)
    side = _texture_side(fine)
    texel_face, points_on_light = _texel_points(vertices, faces, uv, side)
    texture = np.full((side, side, 3), UNCOLOURED, np.uint8)
    known = texel_face >= 0
    texture[known] = _colours_at(points_on_light, fine)
    return TexturedMesh(vertices, faces, light.normals[source], uv.astype(np.float64), _with_gutter(texture, known))


def _texture_side(fine: SurfaceMesh) -> int:
    """Side in px, a power of two, at which texels resolve the fine mesh's median edge."""
    edges = np.linalg.norm(fine.vertices[fine.faces[:, 0]] - fine.vertices[fine.faces[:, 1]], axis=1)
    texel = float(np.median(edges)) / TEXELS_PER_EDGE
    side = np.sqrt(float(fine.face_areas.sum()) / FILL_RATIO) / max(texel, 1e-12)
    return int(np.clip(2 ** np.ceil(np.log2(max(side, 1))), MIN_SIDE, MAX_SIDE))


def _texel_points(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], uv: NDArray[np.float32], side: int
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Face (S,S) of each texel, -1 between charts, and the surface points (K,3) of those with a face, row by row."""
    import cv2

    corner = np.stack([uv[:, 0] * side, (1 - uv[:, 1]) * side], axis=1)[faces]  # (F,3,2) column and row, from the edge
    texel_face = np.full((side, side), -1, np.int32)
    fixed = np.rint((corner - 0.5) * 16).astype(np.int32)  # OpenCV's whole numbers are texels' centres
    for number, triangle in enumerate(fixed):
        cv2.fillConvexPoly(texel_face, triangle, number, lineType=cv2.LINE_8, shift=4)
    row, column = np.nonzero(texel_face >= 0)
    face = texel_face[row, column]
    share = _barycentric(corner[face], np.stack([column, row], axis=1) + 0.5)
    return texel_face, np.einsum("kc,kcd->kd", share, vertices[faces[face]])


def _barycentric(corners: NDArray[np.floating], points: NDArray[np.floating]) -> NDArray[np.float64]:
    """Barycentric weights (K,3) of points (K,2) in triangles (K,3,2), clipped into the triangle."""
    a, b, c = np.swapaxes(np.asarray(corners, np.float64), 0, 1)
    area = _cross(b - a, c - a)
    area = np.where(np.abs(area) > 1e-12, area, 1e-12)
    share = np.stack([_cross(b - points, c - points), _cross(c - points, a - points)], axis=1) / area[:, None]
    share = np.concatenate([share, 1 - share.sum(axis=1, keepdims=True)], axis=1).clip(0, 1)
    return share / share.sum(axis=1, keepdims=True)


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """z component (K,) of the cross product of plane vectors (K,2)."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _colours_at(points: NDArray[np.float64], fine: SurfaceMesh) -> NDArray[np.uint8]:
    """Colours (K,3) at points (K,3): inverse-distance mean of the nearest vertices."""
    count = min(NEIGHBOURS, len(fine.vertices))
    distance, near = cKDTree(fine.vertices).query(points, k=range(1, count + 1))
    weight = 1 / np.maximum(distance, 1e-9)
    weight /= weight.sum(axis=1, keepdims=True)
    return np.rint(np.einsum("kn,knc->kc", weight, fine.colours[near].astype(np.float64))).astype(np.uint8)


def _with_gutter(texture: NDArray[np.uint8], known: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """The texture with the charts' borders repeated for GUTTER px; `known` (S,S) marks texels of charts."""
    if known.all() or not known.any():
        return texture
    distance, nearest = distance_transform_edt(~known, return_indices=True)
    return np.where((distance <= GUTTER)[..., None], texture[tuple(nearest)], texture)
