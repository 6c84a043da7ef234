"""Errors against truth: trajectories (ATE, SimCol3D), surfaces (accuracy, completeness, F-score against a reference
surface) and coverage (points, found and false regions).
"""

from typing import TYPE_CHECKING

from haustra.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from reconstruction.evaluation.coverage_metrics import coverage_errors as coverage_errors
    from reconstruction.evaluation.coverage_metrics import read_true_wall as read_true_wall
    from reconstruction.evaluation.reference_surface import read_reference_surface as read_reference_surface
    from reconstruction.evaluation.surface_metrics import surface_errors as surface_errors
    from reconstruction.evaluation.trajectory_io import read_tum as read_tum
    from reconstruction.evaluation.trajectory_io import write_tum as write_tum
    from reconstruction.evaluation.trajectory_metrics import align_poses as align_poses
    from reconstruction.evaluation.trajectory_metrics import trajectory_errors as trajectory_errors

_MODULE_OF = {
    "align_poses": "reconstruction.evaluation.trajectory_metrics",
    "coverage_errors": "reconstruction.evaluation.coverage_metrics",
    "read_true_wall": "reconstruction.evaluation.coverage_metrics",
    "read_tum": "reconstruction.evaluation.trajectory_io",
    "read_reference_surface": "reconstruction.evaluation.reference_surface",
    "surface_errors": "reconstruction.evaluation.surface_metrics",
    "trajectory_errors": "reconstruction.evaluation.trajectory_metrics",
    "write_tum": "reconstruction.evaluation.trajectory_io",
}
__all__ = [
    "align_poses",
    "coverage_errors",
    "read_reference_surface",
    "read_true_wall",
    "read_tum",
    "surface_errors",
    "trajectory_errors",
    "write_tum",
]
__getattr__ = lazy_names(__name__, _MODULE_OF)
