"""The share of a lumen's wall that was seen: centreline of the cameras' way, hole closing of the wall along it, depth
support and visibility to tell seen from missed, missed regions, unrolled map and figure.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from reconstruction.coverage.centreline import NotATube as NotATube
    from reconstruction.coverage.coverage import Coverage as Coverage
    from reconstruction.coverage.coverage import measure_coverage as measure_coverage
    from reconstruction.coverage.coverage_figure import draw_coverage as draw_coverage
    from reconstruction.coverage.depth_support import DepthSupport as DepthSupport
    from reconstruction.coverage.lumen_diameter import measure_lumen as measure_lumen
    from reconstruction.coverage.unrolled_map import unroll as unroll
    from reconstruction.coverage.visibility import FieldOfView as FieldOfView

_MODULE_OF = {
    "Coverage": "coverage",
    "DepthSupport": "depth_support",
    "FieldOfView": "visibility",
    "NotATube": "centreline",
    "draw_coverage": "coverage_figure",
    "measure_coverage": "coverage",
    "measure_lumen": "lumen_diameter",
    "unroll": "unrolled_map",
}
__all__ = [
    "Coverage",
    "DepthSupport",
    "FieldOfView",
    "NotATube",
    "draw_coverage",
    "measure_coverage",
    "measure_lumen",
    "unroll",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'reconstruction.coverage' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
