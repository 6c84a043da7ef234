"""Our meshes as trimesh's, which writes the text and the container formats."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.mesh.surface_mesh import SurfaceMesh
from reconstruction.mesh.textured_mesh import TexturedMesh


def as_trimesh(mesh: SurfaceMesh, colours: NDArray[np.uint8]) -> Any:
    """`trimesh.Trimesh` of the mesh with a colour (V,3) per vertex."""
    import trimesh

    return trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=mesh.normals, vertex_colors=colours, process=False)


def as_textured_trimesh(mesh: TexturedMesh, material: Any) -> Any:
    """`trimesh.Trimesh` of the mesh with its uv and a trimesh material that holds the texture."""
    import trimesh

    visual = trimesh.visual.TextureVisuals(uv=mesh.uv, material=material)
    return trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=mesh.normals, visual=visual, process=False)
