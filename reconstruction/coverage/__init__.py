"""The share of a lumen's wall that was seen: centreline of the cameras' way, hole closing of the wall along it, depth
support and visibility to tell seen from missed, missed regions, unrolled map and figure.
"""

from typing import TYPE_CHECKING

from haustra.core.lazy_names import lazy_names

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
    "Coverage": "reconstruction.coverage.coverage",
    "DepthSupport": "reconstruction.coverage.depth_support",
    "FieldOfView": "reconstruction.coverage.visibility",
    "NotATube": "reconstruction.coverage.centreline",
    "draw_coverage": "reconstruction.coverage.coverage_figure",
    "measure_coverage": "reconstruction.coverage.coverage",
    "measure_lumen": "reconstruction.coverage.lumen_diameter",
    "unroll": "reconstruction.coverage.unrolled_map",
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
__getattr__ = lazy_names(__name__, _MODULE_OF)
