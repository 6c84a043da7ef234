"""Surface metrics: accuracy, completeness, precision, recall and F-score of points against reference points.

Accuracy and completeness as in Seitz et al., "A comparison and evaluation of multi-view stereo reconstruction
algorithms", CVPR 2006; precision, recall and F-score as in Knapitsch et al., "Tanks and Temples", TOG 2017.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import ReconstructionError
from reconstruction.mesh.surface_mesh import SurfaceMesh

Array = NDArray[np.float64]

SAMPLES_PER_SQUARE_TAU = 16  # points per tau^2 of mesh: about tau/4 apart, so that spacing hardly enters the shares
MAX_SAMPLES = 2_000_000  # points drawn from one mesh


class ReferencePoints(Protocol):
    """Points (N,3) of a reference surface: `seen` is all of it, `required` the part that should have been built."""

    @property
    def seen(self) -> Array: ...

    @property
    def required(self) -> Array: ...


@dataclass(frozen=True)
class SurfaceErrors:
    """Distances in `unit`; shares in [0,1]."""

    accuracy_mean: float  # reconstructed point -> nearest seen reference point
    accuracy_median: float
    completeness_mean: float  # required reference point -> nearest reconstructed point
    completeness_median: float
    chamfer: float  # mean of the two means
    precision: float  # share of reconstructed points nearer than tau to a seen true point
    recall: float  # share of required true points nearer than tau to a reconstructed point
    f_score: float  # harmonic mean of the two
    tau: float
    unit: str
    reconstructed_points: int
    seen_points: int
    required_points: int

    def __str__(self) -> str:
        return (
            f"F-score {100 * self.f_score:.2f} % at {self.tau:g} {self.unit} "
            f"(precision {100 * self.precision:.2f}, recall {100 * self.recall:.2f} %); "
            f"accuracy mean {self.accuracy_mean:.3f}, median {self.accuracy_median:.3f} {self.unit}; "
            f"completeness mean {self.completeness_mean:.3f}, median {self.completeness_median:.3f} {self.unit} "
            f"({self.reconstructed_points} points of the mesh, {self.seen_points} true points seen, "
            f"{self.required_points} required)"
        )


def surface_errors(
    mesh: SurfaceMesh, truth: ReferencePoints, tau: float, generator: np.random.Generator, unit: str = "mm"
) -> SurfaceErrors:
    """Errors of points sampled from the mesh by area, SAMPLES_PER_SQUARE_TAU per tau^2; `tau` in `unit`."""
    wanted = SAMPLES_PER_SQUARE_TAU * float(mesh.face_areas.sum()) / tau**2
    count = int(np.clip(wanted, SAMPLES_PER_SQUARE_TAU, MAX_SAMPLES))
    points = sample_surface(mesh.vertices, mesh.faces, count, generator)
    return point_errors(points, truth.seen, truth.required, tau, unit)


def point_errors(reconstructed: Array, seen: Array, required: Array, tau: float, unit: str = "mm") -> SurfaceErrors:
    """Accuracy and precision of points (N,3) against `seen` (M,3), completeness and recall of `required` (K,3)."""
    from scipy.spatial import cKDTree

    for name, points in {"reconstruction": reconstructed, "seen truth": seen, "required truth": required}.items():
        if points.ndim != 2 or points.shape[1] != 3 or not len(points):
            raise ReconstructionError(f"the {name} must be points (N,3) with N > 0, not {points.shape}")
    accuracy = cKDTree(seen).query(reconstructed)[0]
    completeness = cKDTree(reconstructed).query(required)[0]
    precision, recall = float(np.mean(accuracy < tau)), float(np.mean(completeness < tau))
    return SurfaceErrors(
        accuracy_mean=float(accuracy.mean()),
        accuracy_median=float(np.median(accuracy)),
        completeness_mean=float(completeness.mean()),
        completeness_median=float(np.median(completeness)),
        chamfer=float(accuracy.mean() + completeness.mean()) / 2,
        precision=precision,
        recall=recall,
        f_score=2 * precision * recall / (precision + recall) if precision + recall else 0.0,
        tau=tau,
        unit=unit,
        reconstructed_points=len(reconstructed),
        seen_points=len(seen),
        required_points=len(required),
    )


def sample_surface(
    vertices: Array, faces: NDArray[np.int64], count: int, generator: np.random.Generator
) -> NDArray[np.float64]:
    """`count` points (count,3) drawn uniformly by area from triangles (F,3) of vertices (V,3)."""
    first, second, third = (np.asarray(vertices, np.float64)[faces[:, corner]] for corner in range(3))
    area = np.linalg.norm(np.cross(second - first, third - first), axis=1)
    if not area.sum() > 0:
        raise ReconstructionError("the mesh has no area to sample")
    face = generator.choice(len(faces), size=count, p=area / area.sum())
    # The square root spreads the points evenly over a triangle: Osada et al., "Shape distributions", TOG 2002, eq. 1.
    root, along = np.sqrt(generator.random((count, 1))), generator.random((count, 1))
    return (1 - root) * first[face] + root * (1 - along) * second[face] + root * along * third[face]
