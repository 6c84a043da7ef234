"""Missed regions: connected pieces of unobserved wall, with place, extent, the camera that came nearest, and how likely
it is that at least half of them is in no frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from reconstruction.coverage.centreline import Centreline
from reconstruction.coverage.hole_closing import ClosedWall
from reconstruction.mesh.surface_mesh import connected_faces

Array = NDArray[np.float64]

ONE_SIDED = 0.3  # length of the mean direction (unit circle) below which a region goes all round
# Log odds that at least half of a region is in no frame: OFFSET + SLOPE log(reach in lumen radii). What is merely not
# fused lies in strips beside the measured surface; a pocket reaches far from it. Fitted by
# `python -m benchmarks.coverage_regions` on regions over 5 mm; docs/lab/coverage.md shows how it does on other films.
OFFSET, SLOPE = 7.73, 4.48


@dataclass(frozen=True)
class MissedRegion:
    """A connected piece of unobserved wall. Lengths in the mesh's unit, areas in its square."""

    area: float  # of the closed surface over it
    arc: float  # of its centre, from the start of the visited stretch
    arc_range: tuple[float, float]
    clock: float | None  # hours in (0, 12]; None where the region goes all round
    centre: tuple[float, float, float]
    frame: int  # row of the nearest camera that had it in its cone of view; a fold may have occluded it
    reach: float  # greatest distance of its faces from the mesh

    @property
    def diameter(self) -> float:
        """Diameter of the circle of the same area."""
        return float(2 * np.sqrt(self.area / np.pi))

    def transformed(self, target_from_mesh: Array, scale: float) -> MissedRegion:
        """A copy moved by the Sim(3) `target_from_mesh` (4,4), whose scale is given."""
        x, y, z = (target_from_mesh[:3, :3] @ np.array(self.centre) + target_from_mesh[:3, 3]).tolist()
        start, end = self.arc_range
        arc_range = (scale * start, scale * end)
        return replace(
            self,
            area=scale**2 * self.area,
            arc=scale * self.arc,
            arc_range=arc_range,
            centre=(x, y, z),
            reach=scale * self.reach,
        )


def find_regions(
    closed_wall: ClosedWall, line: Centreline, world_from_camera: Array, half_fov_deg: float
) -> tuple[NDArray[np.int64], list[MissedRegion]]:
    """Connected unobserved pieces of the closed wall: number (F,) of each face, -1 if observed; largest first."""
    region = np.full(len(closed_wall.faces), -1)
    if not closed_wall.unobserved.any():
        return region, []
    piece = connected_faces(closed_wall.faces[closed_wall.unobserved])
    area = closed_wall.areas[closed_wall.unobserved]
    rank = np.argsort(np.argsort(-np.bincount(piece, weights=area), kind="stable"))
    region[closed_wall.unobserved] = rank[piece]
    # A face is judged by its middle, so its corners may lie a little outside the stretch.
    arc_of_vertex = np.clip(line.locate(closed_wall.vertices)[0], closed_wall.arc.min(), closed_wall.arc.max())
    geometry = closed_wall.centroids, closed_wall.areas, arc_of_vertex[closed_wall.faces]
    faces = [np.flatnonzero(region == number) for number in range(len(rank))]
    return region, [_region(rows, closed_wall, geometry, world_from_camera, half_fov_deg) for rows in faces]


def hidden_probability(reach: Array) -> Array:
    """That at least half of a region is in no frame, as completed depth leaves those of 5 mm and more; any shape.
    reach: of regions from the mesh, in lumen radii."""
    return np.asarray(1 / (1 + np.exp(-(OFFSET + SLOPE * np.log(np.maximum(reach, 1e-3))))))


def _region(
    rows: NDArray[np.int64],
    closed_wall: ClosedWall,
    geometry: tuple[Array, Array, Array],
    world_from_camera: Array,
    half_fov_deg: float,
) -> MissedRegion:
    """The region of faces `rows` (K,); geometry: centroids (F,3), areas (F,), arc lengths of corners (F,3)."""
    centroids, areas, corner_arc = geometry
    centre = np.average(centroids[rows], axis=0, weights=areas[rows])
    extent = corner_arc[rows]
    return MissedRegion(
        area=float(areas[rows].sum()),
        arc=float(np.average(closed_wall.arc[rows], weights=areas[rows])),
        arc_range=(float(extent.min()), float(extent.max())),
        clock=_clock(closed_wall.angle[rows], areas[rows]),
        centre=(float(centre[0]), float(centre[1]), float(centre[2])),
        frame=_nearest_view(centre, world_from_camera, half_fov_deg),
        reach=float(closed_wall.distance[rows].max()),
    )


def _clock(angle: Array, area: Array) -> float | None:
    """Area-weighted mean direction of angles (K,) rad in hours (0, 12]; None where the directions cancel."""
    mean = np.sum(area * np.exp(1j * angle)) / area.sum()
    if np.abs(mean) < ONE_SIDED:
        return None
    return float(np.angle(mean) % (2 * np.pi) * 6 / np.pi) or 12.0


def _nearest_view(point: Array, world_from_camera: Array, half_fov_deg: float) -> int:
    """Row of the nearest camera (N,4,4) with the point (3,) in its cone of view; of the nearest of all without one."""
    offset = point - world_from_camera[:, :3, 3]
    distance = np.linalg.norm(offset, axis=1)
    depth = np.einsum("ni,ni->n", offset, world_from_camera[:, :3, 2])
    inside = depth >= np.cos(np.radians(half_fov_deg)) * distance
    return int(np.argmin(np.where(inside, distance, np.inf) if inside.any() else distance))
