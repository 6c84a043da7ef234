"""How much of the lumen's wall was seen where the camera passed, and which regions it missed."""

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
from reconstruction.coverage.hole_closing import Closure, close_wall, connected_faces
from reconstruction.coverage.visibility import FieldOfView
from reconstruction.mesh.surface_mesh import SurfaceMesh

Array = NDArray[np.float64]

ALONG = 0.5  # cosine between view and lumen from which a camera looks along the lumen
SHORTEST = 0.5  # stretch over radius below which there is nothing to judge
LEAST_WALL = 0.5  # mean share of a cross-section's rays that must meet wall
# Radii from one posed frame to the next up to which the lumen between them counts as passed. No tracker follows a
# camera farther than about half of that between two frames, so what is longer is a gap in the poses.
GAP = 1.0
ONE_SIDED = 0.3  # length of the mean direction below which a region goes all round
Intervals = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class MissedRegion:
    """A connected piece of unseen wall. Lengths in the mesh's unit."""

    area: float  # of the closing surface over it
    arc: float  # of its centre, from the start of the visited stretch
    arc_range: tuple[float, float]
    clock: float | None  # hours in (0, 12]; None where the region goes all round
    centre: tuple[float, float, float]
    frame: int  # row of the nearest pose that pointed towards it; a fold may have stood between them

    @property
    def diameter(self) -> float:
        """Of the circle of the same area."""
        return float(2 * np.sqrt(self.area / np.pi))

    def transformed(self, target_from_mesh: Array, scale: float) -> MissedRegion:
        """The same region after the Sim(3) `target_from_mesh` (4,4), whose scale is given."""
        x, y, z = (target_from_mesh[:3, :3] @ np.array(self.centre) + target_from_mesh[:3, 3]).tolist()
        start, end = self.arc_range
        arc_range = (scale * start, scale * end)
        return replace(self, area=scale**2 * self.area, arc=scale * self.arc, arc_range=arc_range, centre=(x, y, z))


@dataclass(frozen=True)
class Segment:
    """Coverage between two arc lengths; `share` in [0,1], areas in squared unit. Of the seen area, `unmeasured_area`
    was in plain view alone: no surface was fused there."""

    start: float
    end: float
    seen_area: float
    missed_area: float
    unmeasured_area: float

    @property
    def share(self) -> float:
        return self.seen_area / max(self.seen_area + self.missed_area, 1e-300)

    @property
    def unmeasured_share(self) -> float:
        """Of all wall, like `share`, of which it is a part."""
        return self.unmeasured_area / max(self.seen_area + self.missed_area, 1e-300)


@dataclass(frozen=True)
class Coverage:
    """What of the visited stretch was seen. `region` (F,) numbers the closing's faces: -1 seen, else a row of
    `regions`, which are sorted by area, largest first. `visited` are the pieces of the stretch that the camera passed,
    in order; between them it has no poses, and nothing is judged."""

    line: Centreline
    closure: Closure
    region: NDArray[np.int64]
    regions: list[MissedRegion]
    visited: Intervals
    radius: float  # median of the lumen over the stretch
    unit: str

    @property
    def stretch(self) -> tuple[float, float]:
        """From the first visited place to the last."""
        return self.visited[0][0], self.visited[-1][1]

    @property
    def length(self) -> float:
        """Of all that was visited."""
        return sum(end - start for start, end in self.visited)

    def is_visited(self, arc: Array) -> NDArray[np.bool_]:
        """Whether each arc length is judged."""
        return within(arc, self.visited)

    @property
    def whole(self) -> Segment:
        return self.segment(*self.stretch)

    @property
    def share(self) -> float:
        return self.whole.share

    def segment(self, start: float, end: float) -> Segment:
        inside = (self.closure.arc >= start) & (self.closure.arc <= end)
        area, unseen = self.closure.areas[inside], self.closure.unseen[inside]
        bare = area[self.closure.unmeasured[inside]]
        return Segment(start, end, float(area[~unseen].sum()), float(area[unseen].sum()), float(bare.sum()))

    def segments(self, length: float) -> list[Segment]:
        """Equal pieces from the start of the stretch; the last is what is left, joined to its neighbour if short.
        A piece in which nothing is judged is left out."""
        count = max(1, int(np.floor((self.stretch[1] - self.stretch[0]) / length + 0.5)))
        ends = self.stretch[0] + length * np.arange(count + 1)
        ends[-1] = self.stretch[1]
        pieces = [self.segment(a, b) for a, b in pairwise(ends.tolist())]
        return [piece for piece in pieces if piece.seen_area + piece.missed_area > 0]

    def transformed(self, target_from_mesh: Array) -> Coverage:
        """The same coverage moved by a Sim(3), given as 4x4 with scale times rotation in its upper left."""
        scale = float(scale_of(target_from_mesh))
        regions = [region.transformed(target_from_mesh, scale) for region in self.regions]
        return Coverage(
            self.line.transformed(target_from_mesh),
            self.closure.transformed(target_from_mesh),
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
    fringe: float = 0.0,
    field_of_view: FieldOfView | None = None,
) -> Coverage:
    """Coverage of the stretch that the cameras (N,4,4, in the order of the video) visited; `unit` is the mesh's.

    A cross-section counts as visited if it crossed the edge of the picture: `half_fov_deg` off axis is where the wall
    around the lumen leaves the view of a camera that passes. What lies farther was seen only from afar and is not
    judged. A surface cut from voxels ends up to a voxel short of what was seen, because all eight corners of a cell
    must be known: give that as `fringe` (mesh unit), and wall so near to the mesh's edge counts as seen. With the
    `picture` that all cameras take, wall of the closing in plain view of two of them counts as seen, too. Raises
    `NotATube`, whose text is one sentence, where mesh or path do not suffice.

    Everything is measured in the first camera's axes and in radii of the lumen, so that the answer moves, turns and
    scales with the mesh.
    """
    if not len(mesh.faces):
        raise NotATube("there is no surface, so coverage cannot be judged")
    if len(world_from_camera) < 2:
        raise NotATube("one camera passes no stretch of the lumen, so coverage cannot be judged")
    # The first camera's place first, as rays are cast in single precision.
    poses = np.linalg.inv(world_from_camera[0]) @ world_from_camera
    own = mesh.transformed(np.linalg.inv(world_from_camera[0]))
    scale = lumen_radius(WallRays(own), poses)
    poses[:, :3, 3] /= scale
    own = own.transformed(np.diag([1 / scale, 1 / scale, 1 / scale, 1]))
    mesh_from_canonical = world_from_camera[0] @ np.diag([scale, scale, scale, 1])
    line = trace_centreline(own, poses, 1.0)
    visited = visited_intervals(line, poses, half_fov_deg)
    inside = within(line.arc, visited)
    if line.wall[inside].mean() < LEAST_WALL:
        raise NotATube(
            f"only {100 * line.wall[inside].mean():.0f} % of the directions around the lumen meet reconstructed wall, "
            "so it is too open to judge"
        )
    begin, radius = visited[0][0], float(np.median(line.radius[inside]))
    line = replace(line, arc=line.arc - begin)
    visited = tuple((start - begin, end - begin) for start, end in visited)
    closure = close_wall(own, line, (0.0, visited[-1][1]), radius, fringe / scale)
    closure = closure.part(within(closure.arc, visited))
    if field_of_view is not None:
        closure = closure.seen_by(own, poses, field_of_view, radius)
    region, regions = _find_regions(closure, line, poses, half_fov_deg)
    return Coverage(line, closure, region, regions, visited, radius, unit).transformed(mesh_from_canonical)


def visited_intervals(line: Centreline, poses: Array, half_fov_deg: float) -> Intervals:
    """Arc lengths whose cross-sections crossed the edge of the picture, as intervals in order that do not touch.

    A camera that looks along the lumen, either way, has at its picture's edge the wall that lies the lumen's radius
    over the tangent of the half angle ahead of it. From one posed frame to the next that place sweeps over the lumen
    between; where it leaps, no posed frame shows that the camera passed what lies there.
    """
    row = line.stations_of(poses[:, :3, 3])
    cosine = np.einsum("ni,ni->n", line.tangents[row], poses[:, :3, 2])
    ahead = np.sign(cosine) * line.radius[row] / np.tan(np.radians(half_fov_deg))
    at_edge = (line.locate(poses[:, :3, 3])[0] + ahead)[np.abs(cosine) >= ALONG]
    radius = float(np.median(line.radius))
    swept = np.sort(np.column_stack([at_edge[:-1], at_edge[1:]]), axis=1)
    swept = np.clip(swept[np.ptp(swept, axis=1) <= GAP * radius], *line.arc[[0, -1]])
    joined: list[tuple[float, float]] = []
    for start, end in swept[np.argsort(swept[:, 0])].tolist():
        if joined and start <= joined[-1][1]:
            joined[-1] = joined[-1][0], max(end, joined[-1][1])
        elif end > start:
            joined.append((start, end))
    if sum(end - start for start, end in joined) < SHORTEST * radius:
        raise NotATube(STANDSTILL)
    return tuple(joined)


def within(arc: Array, intervals: Intervals) -> NDArray[np.bool_]:
    """Whether each arc length lies in one of the intervals."""
    start, end = np.array(intervals).T[:, :, None]
    return ((arc >= start) & (arc <= end)).any(axis=0)


def _find_regions(
    closure: Closure, line: Centreline, poses: Array, half_fov_deg: float
) -> tuple[NDArray[np.int64], list[MissedRegion]]:
    """Connected unseen pieces of the closing, largest first."""
    region = np.full(len(closure.faces), -1)
    if not closure.unseen.any():
        return region, []
    piece = connected_faces(closure.faces[closure.unseen])
    area = closure.areas[closure.unseen]
    rank = np.argsort(np.argsort(-np.bincount(piece, weights=area), kind="stable"))
    region[closure.unseen] = rank[piece]
    centroids, areas, arc_of_vertex = closure.centroids, closure.areas, line.locate(closure.vertices)[0]
    regions = []
    for number in range(len(rank)):
        rows = np.flatnonzero(region == number)
        centre = np.average(centroids[rows], axis=0, weights=areas[rows])
        extent = arc_of_vertex[closure.faces[rows]]
        regions.append(
            MissedRegion(
                area=float(areas[rows].sum()),
                arc=float(np.average(closure.arc[rows], weights=areas[rows])),
                arc_range=(float(extent.min()), float(extent.max())),
                clock=_clock(closure.angle[rows], areas[rows]),
                centre=(float(centre[0]), float(centre[1]), float(centre[2])),
                frame=_nearest_view(centre, poses, half_fov_deg),
            )
        )
    return region, regions


def _clock(angle: Array, area: Array) -> float | None:
    """Hours in (0, 12] of the mean direction; None where the directions outweigh one another."""
    mean = np.sum(area * np.exp(1j * angle)) / area.sum()
    if np.abs(mean) < ONE_SIDED:
        return None
    return float(np.angle(mean) % (2 * np.pi) * 6 / np.pi) or 12.0


def _nearest_view(point: Array, poses: Array, half_fov_deg: float) -> int:
    """The nearest camera that has the point within its cone of view; the nearest of all where none has."""
    offset = point - poses[:, :3, 3]
    distance = np.linalg.norm(offset, axis=1)
    depth = np.einsum("ni,ni->n", offset, poses[:, :3, 2])
    within = depth >= np.cos(np.radians(half_fov_deg)) * distance
    return int(np.argmin(np.where(within, distance, np.inf) if within.any() else distance))
