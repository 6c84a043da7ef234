"""Coverage metrics: an estimated coverage against a reference wall whose faces know whether any frame saw them.

Definitions. The *stretch* is the estimate's visited stretch without gaps in the poses: a reference face belongs to it
by its centroid's arc length on the estimated centreline, within MAX_OFF_LINE lumen radii of that line. True coverage is
the area of the seen faces in it over that of all faces in it. A *true region* is a connected piece (shared vertices) of
unseen faces in it. A face *counts as estimated missed* if the triangle of the closed wall nearest to it is unobserved,
nearest in position and normal together, so that the two sides of a fold are not taken for each other.

A true region over the threshold is *found* if half of its area or more counts as estimated missed. An estimated region
over the threshold is *false* if less than half of the true area that it is nearest to is unseen.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import ReconstructionError
from reconstruction.coverage.coverage import Coverage
from reconstruction.coverage.hole_closing import MAX_OFF_LINE
from reconstruction.coverage.missed_regions import hidden_probability
from reconstruction.mesh.mesh_io import read_face_property, read_mesh
from reconstruction.mesh.surface_mesh import SurfaceMesh, connected_faces

Array = NDArray[np.float64]

NORMAL_WEIGHT = 0.2  # lumen radii per unit of normal difference in the nearest-face distance; opposite sides: 0.4
MIN_OVERLAP = 0.5  # share of a region's area from which it counts as found, or as true


@dataclass(frozen=True)
class JudgedRegion:
    """A reported region over the threshold: how many lumen radii it reaches from the mesh, with what probability at
    least half of it is in no frame, and whether that is so."""

    reach_radii: float
    probability: float
    is_true: bool


@dataclass(frozen=True)
class CoverageErrors:
    """Shares in [0,1], lengths in mm, areas in mm^2; regions over `threshold` in equivalent diameter."""

    estimated: float
    true: float
    length: float  # of the visited stretch
    true_regions: int
    found: int
    estimated_regions: int
    false: int
    threshold: float
    true_area: float
    estimated_area: float
    missed_diameters: tuple[float, ...]  # of the true regions that were not found
    hidden_called_seen: float  # share of the area that was truly not seen
    seen_called_missed: float  # share of the area that was truly seen
    judged: tuple[JudgedRegion, ...]  # the reported regions

    @property
    def error_points(self) -> float:
        """Percentage points, estimate minus truth."""
        return 100 * (self.estimated - self.true)

    def __str__(self) -> str:
        return (
            f"{100 * self.estimated:.1f} % estimated, {100 * self.true:.1f} % true: error {self.error_points:+.1f} "
            f"points over {self.length:.0f} mm visited; missed regions over {self.threshold:g} mm: {self.found} of "
            f"{self.true_regions} found, {self.true_regions - self.found} not found; {self.false} false of "
            f"{self.estimated_regions} reported; {100 * self.hidden_called_seen:.0f} % of the hidden wall is called "
            f"seen, {100 * self.seen_called_missed:.0f} % of the seen wall missed"
        )


@dataclass(frozen=True)
class TrueWall:
    """A reference wall whose faces know whether any frame saw them."""

    mesh: SurfaceMesh  # mm, normals towards the lumen
    seen: NDArray[np.bool_]  # (F,)


def read_true_wall(path: Path | str) -> TrueWall | None:
    """The wall of a `mesh.ply` with the face property `seen`.

    None where it has none, or where all of it was seen: such a mesh was cut to what the camera saw, and does not hold
    what it missed.
    """
    seen = read_face_property(path, "seen")
    return None if seen is None or (seen == 1).all() else TrueWall(read_mesh(path), seen == 1)


def coverage_errors(coverage: Coverage, wall: TrueWall, threshold: float = 5.0) -> CoverageErrors:
    """Errors of a coverage in the axes and unit of the true wall (mm); `threshold`: equivalent diameter of a region."""
    arc, _, off = coverage.line.locate(wall.mesh.vertices[wall.mesh.faces].mean(axis=1))
    inside = coverage.is_visited(arc) & (off < MAX_OFF_LINE * coverage.radius)
    if not inside.any():
        raise ReconstructionError("the true wall lies nowhere along the reconstructed centreline")
    part, seen = SurfaceMesh.from_triangles(wall.mesh.vertices, wall.mesh.faces[inside]), wall.seen[inside]
    area = part.face_areas
    label = estimated_labels(coverage, part)
    piece = connected_faces(part.faces[~seen])
    sizes = np.bincount(piece, weights=area[~seen])
    overlap = np.bincount(piece, weights=area[~seen] * (label[~seen] >= 0)) / np.maximum(sizes, 1e-12)
    large = _diameter(sizes) > threshold
    judged = tuple(
        _judged(region.reach / coverage.radius, _is_true(label == row, seen, area))
        for row, region in enumerate(coverage.regions)
        if region.diameter > threshold
    )
    return CoverageErrors(
        estimated=coverage.share,
        true=float(area[seen].sum() / area.sum()),
        length=coverage.length,
        true_regions=int(large.sum()),
        found=int((large & (overlap >= MIN_OVERLAP)).sum()),
        estimated_regions=len(judged),
        false=sum(not region.is_true for region in judged),
        threshold=threshold,
        true_area=float(area.sum()),
        estimated_area=coverage.whole.seen_area + coverage.whole.missed_area,
        missed_diameters=tuple(np.round(_diameter(sizes[large & (overlap < MIN_OVERLAP)]), 1).tolist()),
        hidden_called_seen=_share(area, label < 0, ~seen),
        seen_called_missed=_share(area, label >= 0, seen),
        judged=judged,
    )


def _judged(reach_radii: float, is_true: bool) -> JudgedRegion:
    return JudgedRegion(reach_radii, float(hidden_probability(np.array(reach_radii))), is_true)


def estimated_labels(coverage: Coverage, wall: SurfaceMesh) -> NDArray[np.int64]:
    """(F,) estimated missed region (a row of `coverage.regions`) of each face of a true wall, or -1."""
    from scipy.spatial import cKDTree

    weight = NORMAL_WEIGHT * coverage.radius
    tree = cKDTree(_placed(coverage.closed_wall.surface, weight))
    return coverage.region[tree.query(_placed(wall, weight))[1]]


def _placed(mesh: SurfaceMesh, weight: float) -> Array:
    """Centroid and weighted unit normal of each face, (F,6)."""
    return np.hstack([mesh.vertices[mesh.faces].mean(axis=1), weight * mesh.face_normals])


def _diameter(area: NDArray[Any]) -> Array:
    """Equivalent diameters of areas, any shape."""
    return np.asarray(2 * np.sqrt(area / np.pi), np.float64)


def _share(area: Array, part: NDArray[np.bool_], of: NDArray[np.bool_]) -> float:
    """Share of the area (F,) in mask `of` (F,) that is also in mask `part` (F,); 0 where `of` has none."""
    return float(area[part & of].sum() / max(area[of].sum(), 1e-300))


def _is_true(part: NDArray[np.bool_], seen: NDArray[np.bool_], area: Array) -> bool:
    """Whether MIN_OVERLAP or more of the area in mask `part` (F,) is truly unseen."""
    return _share(area, ~seen, part) >= MIN_OVERLAP
