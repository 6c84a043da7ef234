"""Mesh decimation by quadric error, keeping colour, confidence and observations per vertex."""

from __future__ import annotations

import numpy as np

from reconstruction.mesh.open3d_import import import_open3d
from reconstruction.mesh.surface_mesh import SurfaceMesh

CLUSTER_FROM = 10  # times the target from which vertices are clustered first: quadric errors take 10 s a million faces
CLUSTER_TO = 4  # times the target that clustering leaves


def decimated(mesh: SurfaceMesh, triangles: int) -> SurfaceMesh:
    """The mesh reduced to about `triangles` faces by quadric error; itself if it has no more than that.

    Garland and Heckbert, "Surface simplification using quadric error metrics", SIGGRAPH 1997, as Open3D has it. Colour,
    confidence and observations are those of the nearest vertex of the original.
    """
    if len(mesh.faces) <= triangles:
        return mesh
    from scipy.spatial import cKDTree

    o3d = import_open3d()
    # Centred, as quadric errors are squares of coordinates.
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    whole = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices - middle), o3d.utility.Vector3iVector(mesh.faces.astype(np.int32))
    )
    if len(mesh.faces) > CLUSTER_FROM * triangles:
        cell = float(np.sqrt(2 * mesh.face_areas.sum() / (CLUSTER_TO * triangles)))  # two triangles a square cell
        whole = whole.simplify_vertex_clustering(cell)
    few = whole.simplify_quadric_decimation(triangles)
    few.remove_degenerate_triangles()
    few.remove_unreferenced_vertices()
    vertices = np.asarray(few.vertices) + middle
    nearest = cKDTree(mesh.vertices).query(vertices)[1]
    return SurfaceMesh.from_triangles(
        vertices,
        np.asarray(few.triangles),
        colours=mesh.colours[nearest],
        confidence=mesh.confidence[nearest],
        observations=mesh.observations[nearest],
    )
