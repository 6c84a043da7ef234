"""A triangle mesh with a texture atlas instead of a colour per vertex."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class TexturedMesh:
    """Triangles with a texture image; vertices repeat along the charts' seams."""

    vertices: NDArray[np.float64]  # (V,3)
    faces: NDArray[np.int64]  # (F,3) rows of `vertices`
    normals: NDArray[np.float64]  # (V,3) unit length
    uv: NDArray[np.float64]  # (V,2) in [0,1], v upwards as OBJ has it
    texture: NDArray[np.uint8]  # (S,S,3) sRGB, first row at v = 1
