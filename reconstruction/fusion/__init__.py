"""Posed RGB-D frames to a surface: frames are checked and weighted, their depth voted on by neighbours, their colours
corrected for illumination, and all integrated into a TSDF in sparse voxel blocks, from which marching cubes extract
the mesh.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from reconstruction.fusion.depth_consistency import Agreement as Agreement
    from reconstruction.fusion.depth_consistency import DepthView as DepthView
    from reconstruction.fusion.depth_consistency import agreement as agreement
    from reconstruction.fusion.photometry import Illumination as Illumination
    from reconstruction.fusion.photometry import fit_illumination as fit_illumination
    from reconstruction.fusion.tsdf import SurfaceFusion as SurfaceFusion
    from reconstruction.fusion.tsdf import TsdfSettings as TsdfSettings
    from reconstruction.fusion.tsdf import choose_voxel_size as choose_voxel_size

_MODULE_OF = {
    "Agreement": "depth_consistency",
    "DepthView": "depth_consistency",
    "TsdfSettings": "tsdf",
    "Illumination": "photometry",
    "SurfaceFusion": "tsdf",
    "agreement": "depth_consistency",
    "choose_voxel_size": "tsdf",
    "fit_illumination": "photometry",
}
__all__ = [
    "Agreement",
    "DepthView",
    "Illumination",
    "SurfaceFusion",
    "TsdfSettings",
    "agreement",
    "choose_voxel_size",
    "fit_illumination",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'reconstruction.fusion' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
