"""GLB (glTF 2.0): normal and colour per vertex, or a texture. The format means metres, so a viewer shows a millimetre
as a metre."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from reconstruction.mesh.formats.trimesh_export import as_textured_trimesh, as_trimesh
from reconstruction.mesh.surface_mesh import SurfaceMesh
from reconstruction.mesh.textured_mesh import TexturedMesh


def write_glb(mesh: SurfaceMesh, path: Path) -> None:
    """Write with linear colours.

    glTF 2.0, section 3.7.2.1: COLOR_0 is linear; written as sRGB it looks washed out in every viewer.
    """
    as_trimesh(mesh, linear_from_srgb(mesh.colours)).export(path, include_normals=True)


def write_textured_glb(mesh: TexturedMesh, path: Path) -> None:
    """Write with the texture inside, as base colour of a rough, non-metallic, double-sided material."""
    import trimesh
    from PIL import Image

    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.fromarray(mesh.texture), metallicFactor=0.0, roughnessFactor=0.9, doubleSided=True
    )
    as_textured_trimesh(mesh, material).export(path, include_normals=True)


def linear_from_srgb(colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Linear colours of sRGB ones, 8 bit, by IEC 61966-2-1."""
    value = colours / 255
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return np.rint(255 * linear).astype(np.uint8)


def srgb_from_linear(colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The inverse of `linear_from_srgb`, to the rounding of eight bits."""
    value = colours / 255
    srgb = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return np.rint(255 * srgb).astype(np.uint8)
