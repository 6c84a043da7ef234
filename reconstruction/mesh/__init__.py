"""The triangle mesh with confidence and observations per vertex: files, decimation, texture atlas, rendering by ray
casting.
"""

from typing import TYPE_CHECKING

from haustra.core.lazy_names import lazy_names

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
    "SurfaceMesh": "reconstruction.mesh.surface_mesh",
    "TexturedMesh": "reconstruction.mesh.textured_mesh",
    "decimated": "reconstruction.mesh.decimation",
    "drop_small_components": "reconstruction.mesh.surface_mesh",
    "read_mesh": "reconstruction.mesh.mesh_io",
    "render_mesh": "reconstruction.mesh.rendering",
    "write_mesh": "reconstruction.mesh.mesh_io",
    "write_textured": "reconstruction.mesh.mesh_io",
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
__getattr__ = lazy_names(__name__, _MODULE_OF)
