"""OBJ: colour per vertex (`v x y z r g b`, read by MeshLab, Blender and Open3D though not in the standard), or a
texture in two files beside it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from reconstruction.mesh.formats.trimesh_export import as_textured_trimesh, as_trimesh
from reconstruction.mesh.surface_mesh import SurfaceMesh
from reconstruction.mesh.textured_mesh import TexturedMesh


def write_obj(mesh: SurfaceMesh, path: Path) -> None:
    """Write with normal and colour per vertex."""
    as_trimesh(mesh, mesh.colours).export(path, include_normals=True)


def write_textured_obj(mesh: TexturedMesh, path: Path) -> None:
    """Write with `NAME.mtl` and `NAME_texture.png` beside it."""
    import trimesh
    from PIL import Image

    image: Any = Image.fromarray(mesh.texture)
    material = trimesh.visual.material.SimpleMaterial(image=image, diffuse=[255, 255, 255, 255])
    material.name = f"{path.stem}_texture"
    as_textured_trimesh(mesh, material).export(path, include_normals=True, mtl_name=f"{path.stem}.mtl")
