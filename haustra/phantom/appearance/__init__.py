"""Reflectance, gloss and fine normals of the wall: mucosa, vessels, stool and fluid on the unrolled sheet, and presets
of the named scenes.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from haustra.phantom.appearance.coating import Coating as Coating
    from haustra.phantom.appearance.coating import coat as coat
    from haustra.phantom.appearance.texture import SurfaceTexture as SurfaceTexture
    from haustra.phantom.appearance.vessels import polygon_network as polygon_network
    from haustra.phantom.appearance.vessels import vessel_trees as vessel_trees

_MODULE_OF = {
    "Coating": "coating",
    "SurfaceTexture": "texture",
    "coat": "coating",
    "polygon_network": "vessels",
    "vessel_trees": "vessels",
}
__all__ = ["Coating", "SurfaceTexture", "coat", "polygon_network", "vessel_trees"]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'haustra.phantom.appearance' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
