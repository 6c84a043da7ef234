"""What a file format of meshes must provide: one writer, and what a reader has to know of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from reconstruction.mesh.surface_mesh import SurfaceMesh
from reconstruction.mesh.textured_mesh import TexturedMesh


@dataclass(frozen=True)
class MeshFormat:
    """A row of `MESH_FORMATS`. Coordinates are written in the mesh's own unit."""

    write: Callable[[SurfaceMesh, Path], None]
    write_textured: Callable[[TexturedMesh, Path], None] | None = None  # None: the format holds no texture
    without_faces: bool = False  # it can hold a mesh that has no faces
    srgb: Callable[[NDArray[np.uint8]], NDArray[np.uint8]] | None = None  # of colours as the file has them; None: sRGB
    repeats_corners: bool = False  # each face has vertices of its own, which a reader must merge
    write_only: bool = False  # no reader is at hand that needs no large package
