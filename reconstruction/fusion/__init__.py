"""Posed RGB-D frames to a surface: frames are checked and weighted, their depth voted on by neighbours, their colours
corrected for illumination, and all integrated into a TSDF in sparse voxel blocks, from which marching cubes extract
the mesh.
"""

from typing import TYPE_CHECKING

from haustra.core.lazy_names import lazy_names

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
    "Agreement": "reconstruction.fusion.depth_consistency",
    "DepthView": "reconstruction.fusion.depth_consistency",
    "TsdfSettings": "reconstruction.fusion.tsdf",
    "Illumination": "reconstruction.fusion.photometry",
    "SurfaceFusion": "reconstruction.fusion.tsdf",
    "agreement": "reconstruction.fusion.depth_consistency",
    "choose_voxel_size": "reconstruction.fusion.tsdf",
    "fit_illumination": "reconstruction.fusion.photometry",
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
__getattr__ = lazy_names(__name__, _MODULE_OF)
