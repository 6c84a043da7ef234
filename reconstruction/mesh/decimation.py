"""Mesh decimation by quadric error, keeping colour, confidence and observations per vertex."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from reconstruction.mesh.surface_mesh import SurfaceMesh

# How eagerly edges are collapsed, in the order in which it is tried: pyfqmr's `aggressiveness`, and whether the mesh's
# borders stay. Borders that stay keep the mesh's holes as they are, but few faces cannot be reached with them.
ATTEMPTS = ((3.0, True), (5.0, False))


def decimated(mesh: SurfaceMesh, triangles: int) -> SurfaceMesh:
    """The mesh reduced to about `triangles` faces by quadric error; itself if it has no more than that.

    Garland and Heckbert, "Surface simplification using quadric error metrics", SIGGRAPH 1997, as pyfqmr has it. Colour,
    confidence and observations are those of the nearest vertex of the original.
    """
    if len(mesh.faces) <= triangles:
        return mesh
    from scipy.spatial import cKDTree

    # Centred, as quadric errors are squares of coordinates, and of one size in every unit: pyfqmr's limits are lengths.
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    middle, size = (low + high) / 2, max(float(np.linalg.norm(high - low)), 1e-300)
    unit = (mesh.vertices - middle) / size
    for aggressiveness, keep_border in ATTEMPTS:
        vertices, faces = _collapsed(unit, mesh.faces, triangles, aggressiveness, keep_border)
        if len(faces) <= triangles:
            break
    vertices = vertices * size + middle
    nearest = cKDTree(mesh.vertices).query(vertices)[1]
    return SurfaceMesh.from_triangles(
        vertices,
        faces,
        colours=mesh.colours[nearest],
        confidence=mesh.confidence[nearest],
        observations=mesh.observations[nearest],
    )


def _collapsed(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], triangles: int, aggressiveness: float, keep_border: bool
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices (V,3) and faces (F,3) that are left, each face with three different corners."""
    import pyfqmr

    simplifier = pyfqmr.Simplify()
    simplifier.setMesh(vertices, faces)
    simplifier.simplify_mesh(triangles, aggressiveness=aggressiveness, preserve_border=keep_border, verbose=False)
    left, corners, _ = simplifier.getMesh()
    corners = np.asarray(corners, np.int64)
    whole = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
    return np.asarray(left, np.float64), corners[whole]
