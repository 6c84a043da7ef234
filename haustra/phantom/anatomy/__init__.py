"""Geometry of a gut: a centreline, a wall as radius over arc length and angle with haustral folds and lesions, and the
mesh they make.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from haustra.phantom.anatomy.bulb import Bulb as Bulb
    from haustra.phantom.anatomy.centreline import Centreline as Centreline
    from haustra.phantom.anatomy.colon import Colon as Colon
    from haustra.phantom.anatomy.colon import build_colon as build_colon
    from haustra.phantom.anatomy.colon import grid_normals as grid_normals
    from haustra.phantom.anatomy.folds import Fold as Fold
    from haustra.phantom.anatomy.lesions import Diverticulum as Diverticulum
    from haustra.phantom.anatomy.lesions import Polyp as Polyp

_MODULE_OF = {
    "Bulb": "bulb",
    "Centreline": "centreline",
    "Colon": "colon",
    "Diverticulum": "lesions",
    "Fold": "folds",
    "Polyp": "lesions",
    "build_colon": "colon",
    "grid_normals": "colon",
}
__all__ = ["Bulb", "Centreline", "Colon", "Diverticulum", "Fold", "Polyp", "build_colon", "grid_normals"]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'haustra.phantom.anatomy' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
