"""A piece of the growing surface as it travels between processes and to the page."""

import struct
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from reconstruction.mesh.surface_mesh import SurfaceMesh

# What became of a keyframe's depth: in the surface; the keyframes before it contradict it; nothing of it was sure.
KeyframeFate = Literal["fused", "contradicted", "unsure"]


@dataclass(frozen=True)
class SurfacePart:
    """vertices (V,3) float32 in the map's axes and unit; faces (F,3) uint32; colours (V,3) uint8.

    number: of the part; version: grows when it changes. map_number: of the submap that it belongs to; frames: first and
    last of its keyframes. voxel: that it was cut from, in the map's unit.
    """

    number: int
    version: int
    map_number: int
    frames: tuple[int, int]
    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]
    colours: NDArray[np.uint8]
    voxel: float

    def to_bytes(self) -> bytes:
        """Two 32-bit counts, then vertices, faces and colours, little-endian."""
        head = struct.pack("<II", len(self.vertices), len(self.faces))
        arrays = (self.vertices.astype("<f4"), self.faces.astype("<u4"), self.colours)
        return head + b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)


def part_of(
    mesh: SurfaceMesh, number: int, version: int, map_number: int, frames: tuple[int, int], voxel: float
) -> SurfacePart:
    """The part that a mesh of colours 0 to 255 is."""
    colours = np.rint(mesh.colours).clip(0, 255).astype(np.uint8)
    vertices, faces = mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32)
    return SurfacePart(number, version, map_number, frames, vertices, faces, colours, voxel)
