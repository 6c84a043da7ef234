"""The triangle mesh with confidence and observations per vertex: files, decimation, texture atlas, rendering by ray
casting.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from reconstruction.mesh.decimation import decimated as decimated
    from reconstruction.mesh.mesh_io import read_mesh as read_mesh
    from reconstruction.mesh.mesh_io import write_mesh as write_mesh
    from reconstruction.mesh.mesh_io import write_textured as write_textured
    from reconstruction.mesh.rendering import render_mesh as render_mesh
    from reconstruction.mesh.surface_mesh import SurfaceMesh as SurfaceMesh
    from reconstruction.mesh.surface_mesh import drop_small_components as drop_small_components
    from reconstruction.mesh.textured_mesh import TexturedMesh as TexturedMesh

_MODULE_OF = {
    "SurfaceMesh": "surface_mesh",
    "TexturedMesh": "textured_mesh",
    "decimated": "decimation",
    "drop_small_components": "surface_mesh",
    "read_mesh": "mesh_io",
    "render_mesh": "rendering",
    "write_mesh": "mesh_io",
    "write_textured": "mesh_io",
}
__all__ = [
    "SurfaceMesh",
    "TexturedMesh",
    "decimated",
    "drop_small_components",
    "read_mesh",
    "render_mesh",
    "write_mesh",
    "write_textured",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'reconstruction.mesh' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
