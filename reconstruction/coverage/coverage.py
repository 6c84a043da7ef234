"""Coverage: the share of the lumen's wall that was seen along the visited stretch, and the regions missed there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from haustra.core.sim3 import scale_of
from reconstruction.coverage.centreline import (
    STANDSTILL,
    Centreline,
    NotATube,
    WallRays,
    lumen_radius,
    trace_centreline,
)
from reconstruction.coverage.hole_closing import ClosedWall, close_holes
from reconstruction.coverage.missed_regions import MissedRegion, find_regions
from reconstruction.coverage.visibility import FieldOfView
from reconstruction.mesh.surface_mesh import SurfaceMesh

Array = NDArray[np.float64]

MIN_ALONG = 0.5  # cosine between viewing direction and lumen from which a camera looks along the lumen
MIN_STRETCH = 0.5  # visited length in lumen radii below which there is nothing to judge
MIN_WALL_SHARE = 0.5  # mean share of a cross-section's rays that must meet wall
# Lumen radii between consecutive posed frames up to which the lumen between them counts as passed. No tracker follows
# a camera farther than about half of that between two frames: what is longer is a gap in the poses.
MAX_STEP = 1.0
Intervals = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Segment:
    """Coverage between two arc lengths (mesh's unit); areas in squared unit, shares in [0,1]."""

    start: float
    end: float
    seen_area: float
    missed_area: float
    unmeasured_area: float  # part of the seen area that is visible but where no surface was fused

    @property
    def share(self) -> float:
        """Seen area over all area."""
        return self.seen_area / max(self.seen_area + self.missed_area, 1e-300)

    @property
    def unmeasured_share(self) -> float:
        """Unmeasured area over all area: a part of `share`."""
        return self.unmeasured_area / max(self.seen_area + self.missed_area, 1e-300)


@dataclass(frozen=True)
class Coverage:
    """Coverage of the visited stretch, in the mesh's axes and unit."""

    line: Centreline
    closed_wall: ClosedWall
    region: NDArray[np.int64]  # (F,) of each face of the closed wall: -1 seen, else a row of `regions`
    regions: list[MissedRegion]  # by area, largest first
    visited: Intervals  # arc lengths that the camera passed, in order; between them it has no poses: not judged
    radius: float  # median of the lumen over the stretch
    unit: str

    @property
    def stretch(self) -> tuple[float, float]:
        """Arc lengths of the first and the last visited cross-section."""
        return self.visited[0][0], self.visited[-1][1]

    @property
    def length(self) -> float:
        """Sum of the visited intervals' lengths."""
        return sum(end - start for start, end in self.visited)

    def is_visited(self, arc: Array) -> NDArray[np.bool_]:
        """(N,) whether each arc length (N,) is judged."""
        return within(arc, self.visited)

    @property
    def whole(self) -> Segment:
        """All of the visited stretch."""
        return self.segment(*self.stretch)

    @property
    def share(self) -> float:
        """Seen area over all area of the visited stretch, in [0,1]."""
        return self.whole.share

    def segment(self, start: float, end: float) -> Segment:
        """Coverage between two arc lengths, by the faces' centroids."""
        inside = (self.closed_wall.arc >= start) & (self.closed_wall.arc <= end)
        area, unobserved = self.closed_wall.areas[inside], self.closed_wall.unobserved[inside]
        bare = area[self.closed_wall.unmeasured[inside]]
        return Segment(start, end, float(area[~unobserved].sum()), float(area[unobserved].sum()), float(bare.sum()))

    def segments(self, length: float) -> list[Segment]:
        """Pieces of equal `length` from the start of the stretch; a short rest is joined to the last one.

        A piece in which nothing is judged is left out.
        """
        count = max(1, int(np.floor((self.stretch[1] - self.stretch[0]) / length + 0.5)))
        ends = self.stretch[0] + length * np.arange(count + 1)
        ends[-1] = self.stretch[1]
        pieces = [self.segment(a, b) for a, b in pairwise(ends.tolist())]
        return [piece for piece in pieces if piece.seen_area + piece.missed_area > 0]

    def transformed(self, target_from_mesh: Array) -> Coverage:
        """A copy moved by a Sim(3), given as (4,4) with scale times rotation in its upper left."""
        scale = float(scale_of(target_from_mesh))
        regions = [region.transformed(target_from_mesh, scale) for region in self.regions]
        return Coverage(
            self.line.transformed(target_from_mesh),
            self.closed_wall.transformed(target_from_mesh),
            self.region,
            regions,
            tuple((scale * start, scale * end) for start, end in self.visited),
            scale * self.radius,
            self.unit,
        )


def measure_coverage(
    mesh: SurfaceMesh,
    world_from_camera: Array,
    half_fov_deg: float = 45.0,
    unit: str = "mm",
    edge_tolerance: float = 0.0,
    field_of_view: FieldOfView | None = None,
) -> Coverage:
    """Coverage of the stretch that the cameras (N,4,4, in the order of the video) visited; `unit` is the mesh's.

    A cross-section counts as visited if it crossed the edge of the image: wall around the lumen leaves the view of a
    passing camera at `half_fov_deg` off the axis. Wall beyond was seen only from afar and is not judged. A surface cut
    from voxels ends up to a voxel short of what was seen, because all eight corners of a cell must be known: with that
    length (mesh unit) as `edge_tolerance`, wall so near to the mesh's boundary counts as seen. With `field_of_view`,
    common to all cameras, wall of the closed surface that is visible from two of them counts as seen, too. Raises
    `NotATube`, whose text is one sentence, where mesh or path do not suffice.

    Everything is measured in the first camera's axes and in lumen radii, so that the result moves, turns and scales
    with the mesh.
    """
    own, canonical_from_camera, scale = _canonical(mesh, world_from_camera)
    line, visited, radius = _visited_line(own, canonical_from_camera, half_fov_deg)
    closed_wall = close_holes(own, line, (0.0, visited[-1][1]), radius, edge_tolerance / scale)
    closed_wall = closed_wall.with_faces(within(closed_wall.arc, visited))
    if field_of_view is not None:
        closed_wall = closed_wall.with_visible(own, canonical_from_camera, field_of_view, radius)
    region, regions = find_regions(closed_wall, line, canonical_from_camera, half_fov_deg)
    mesh_from_canonical = world_from_camera[0] @ np.diag([scale, scale, scale, 1])
    return Coverage(line, closed_wall, region, regions, visited, radius, unit).transformed(mesh_from_canonical)


def _canonical(mesh: SurfaceMesh, world_from_camera: Array) -> tuple[SurfaceMesh, Array, float]:
    """Mesh and cameras (N,4,4) in the first camera's axes with the lumen's radius as unit, and that radius.

    The first camera is the origin since rays are cast in single precision.
    """
    if not len(mesh.faces):
        raise NotATube("there is no surface, so coverage cannot be judged")
    if len(world_from_camera) < 2:
        raise NotATube("one camera passes no stretch of the lumen, so coverage cannot be judged")
    first_from_camera = np.linalg.inv(world_from_camera[0]) @ world_from_camera
    own = mesh.transformed(np.linalg.inv(world_from_camera[0]))
    scale = lumen_radius(WallRays(own), first_from_camera)
    first_from_camera[:, :3, 3] /= scale
    return own.transformed(np.diag([1 / scale, 1 / scale, 1 / scale, 1])), first_from_camera, scale


def _visited_line(
    mesh: SurfaceMesh, world_from_camera: Array, half_fov_deg: float
) -> tuple[Centreline, Intervals, float]:
    """Centreline with arc length 0 where the visited stretch begins, visited intervals, median lumen radius there."""
    line = trace_centreline(mesh, world_from_camera, 1.0)
    visited = visited_intervals(line, world_from_camera, half_fov_deg)
    inside = within(line.arc, visited)
    if line.wall[inside].mean() < MIN_WALL_SHARE:
        raise NotATube(
            f"only {100 * line.wall[inside].mean():.0f} % of the directions around the lumen meet reconstructed wall, "
            "so it is too open to judge"
        )
    begin = visited[0][0]
    shifted = tuple((start - begin, end - begin) for start, end in visited)
    return replace(line, arc=line.arc - begin), shifted, float(np.median(line.radius[inside]))


def visited_intervals(line: Centreline, world_from_camera: Array, half_fov_deg: float) -> Intervals:
    """Arc lengths whose cross-sections crossed the edge of the image, as disjoint intervals in order.

    A camera (N,4,4) that looks along the lumen, either way, has at its image's edge the wall that is the lumen's radius
    over tan(`half_fov_deg`) ahead of it. Between consecutive posed frames that cross-section sweeps over the lumen;
    where it jumps by more than MAX_STEP radii, no posed frame shows that the camera passed.
    """
    centres = world_from_camera[:, :3, 3]
    row = line.stations_of(centres)
    cosine = np.einsum("ni,ni->n", line.tangents[row], world_from_camera[:, :3, 2])
    ahead = np.sign(cosine) * line.radius[row] / np.tan(np.radians(half_fov_deg))
    at_edge = (line.locate(centres)[0] + ahead)[np.abs(cosine) >= MIN_ALONG]
    radius = float(np.median(line.radius))
    swept = np.sort(np.column_stack([at_edge[:-1], at_edge[1:]]), axis=1)
    swept = np.clip(swept[np.ptp(swept, axis=1) <= MAX_STEP * radius], *line.arc[[0, -1]])
    joined = _joined(swept[np.argsort(swept[:, 0])].tolist())
    if sum(end - start for start, end in joined) < MIN_STRETCH * radius:
        raise NotATube(STANDSTILL)
    return joined


def _joined(intervals: list[list[float]]) -> Intervals:
    """Union of intervals in order of their starts, as disjoint intervals."""
    joined: list[tuple[float, float]] = []
    for start, end in intervals:
        if joined and start <= joined[-1][1]:
            joined[-1] = joined[-1][0], max(end, joined[-1][1])
        elif end > start:
            joined.append((start, end))
    return tuple(joined)


def within(arc: Array, intervals: Intervals) -> NDArray[np.bool_]:
    """(N,) whether each arc length (N,) lies in one of the intervals."""
    start, end = np.array(intervals).T[:, :, None]
    return ((arc >= start) & (arc <= end)).any(axis=0)
