"""File formats of meshes: PLY with all vertex data, GLB and OBJ with colours or a texture, STL with the shape alone.

`MESH_FORMATS` maps a suffix to its `MeshFormat`; `mesh_io` writes and reads by it.
"""

from reconstruction.mesh.formats.mesh_format import MeshFormat
from reconstruction.mesh.formats.registry import MESH_FORMATS

__all__ = ["MESH_FORMATS", "MeshFormat"]
