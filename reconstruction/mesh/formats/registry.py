"""The file formats of meshes by suffix. A new one is a file beside this and a row here (docs/extending.md)."""

from __future__ import annotations

from reconstruction.mesh.formats.glb import srgb_from_linear, write_glb, write_textured_glb
from reconstruction.mesh.formats.mesh_format import MeshFormat
from reconstruction.mesh.formats.obj import write_obj, write_textured_obj
from reconstruction.mesh.formats.pcd import write_pcd
from reconstruction.mesh.formats.ply import write_ply
from reconstruction.mesh.formats.stl import write_stl
from reconstruction.mesh.formats.vtp import write_vtp

MESH_FORMATS: dict[str, MeshFormat] = {
    ".ply": MeshFormat(write_ply, without_faces=True),
    ".glb": MeshFormat(write_glb, write_textured_glb, srgb=srgb_from_linear),
    ".obj": MeshFormat(write_obj, write_textured_obj),
    ".stl": MeshFormat(write_stl, repeats_corners=True),
    ".vtp": MeshFormat(write_vtp, write_only=True),
    ".pcd": MeshFormat(write_pcd, without_faces=True, write_only=True),
}
