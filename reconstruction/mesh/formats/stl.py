"""STL: triangles only."""

from __future__ import annotations

from pathlib import Path

from reconstruction.mesh.formats.trimesh_export import as_trimesh
from reconstruction.mesh.surface_mesh import SurfaceMesh


def write_stl(mesh: SurfaceMesh, path: Path) -> None:
    """Write each triangle with corners of its own."""
    as_trimesh(mesh, mesh.colours).export(path)
