"""How much of the lumen's wall was seen where the camera passed, and which regions it missed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from reconstruction.centreline import Centreline, NotATube, WallRays, lumen_radius, trace_centreline
from reconstruction.closure import Closure, close_wall, connected_faces
from reconstruction.mesh import SurfaceMesh

Array = NDArray[np.float64]

ALONG = 0.5  # cosine between view and lumen from which a camera looks along the lumen
SHORTEST = 0.5  # stretch over radius below which there is nothing to judge
LEAST_WALL = 0.5  # mean share of a cross-section's rays that must meet wall


@dataclass(frozen=True)
class MissedRegion:
    """A connected piece of unseen wall. Lengths in the mesh's unit."""

    area: float  # of the closing surface over it
    arc: float  # of its centre, from the start of the visited stretch
    arc_range: tuple[float, float]
    clock: float  # hours in (0, 12]
    centre: tuple[float, float, float]
    frame: int  # row of the pose nearest to it

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
    """Coverage between two arc lengths; `share` in [0,1], areas in squared unit."""

    start: float
    end: float
    seen_area: float
    missed_area: float

    @property
    def share(self) -> float:
        return self.seen_area / max(self.seen_area + self.missed_area, 1e-300)


@dataclass(frozen=True)
class Coverage:
    """What of the visited stretch was seen. `region` (F,) numbers the closing's faces: -1 seen, else a row of
    `regions`, which are sorted by area, largest first."""

    line: Centreline
    closure: Closure
    region: NDArray[np.int64]
    regions: list[MissedRegion]
    stretch: tuple[float, float]
    radius: float  # median of the lumen over the stretch
    unit: str

    @property
    def length(self) -> float:
        return self.stretch[1] - self.stretch[0]

    @property
    def whole(self) -> Segment:
        return self.segment(*self.stretch)

    @property
    def share(self) -> float:
        return self.whole.share

    def segment(self, start: float, end: float) -> Segment:
        inside = (self.closure.arc >= start) & (self.closure.arc <= end)
        area, unseen = self.closure.areas[inside], self.closure.unseen[inside]
        return Segment(start, end, float(area[~unseen].sum()), float(area[unseen].sum()))

    def segments(self, length: float) -> list[Segment]:
        """Equal pieces from the start of the stretch; the last is what is left, joined to its neighbour if short."""
        count = max(1, int(np.floor(self.length / length + 0.5)))
        ends = self.stretch[0] + length * np.arange(count + 1)
        ends[-1] = self.stretch[1]
        return [self.segment(a, b) for a, b in pairwise(ends.tolist())]

    def transformed(self, target_from_mesh: Array) -> Coverage:
        """The same coverage moved by a Sim(3), given as 4x4 with scale times rotation in its upper left."""
        scale = float(np.cbrt(np.linalg.det(target_from_mesh[:3, :3])))
        regions = [region.transformed(target_from_mesh, scale) for region in self.regions]
        return Coverage(
            self.line.transformed(target_from_mesh),
            self.closure.transformed(target_from_mesh),
            self.region,
            regions,
            (scale * self.stretch[0], scale * self.stretch[1]),
            scale * self.radius,
            self.unit,
        )


def measure_coverage(
    mesh: SurfaceMesh,
    world_from_camera: Array,
    half_fov_deg: float = 45.0,
    unit: str = "mm",
    fringe: float = 0.0,
) -> Coverage:
    """Coverage of the stretch that the cameras (N,4,4, in the order of the video) visited; `unit` is the mesh's.

    A cross-section counts as visited if it crossed the edge of the picture: `half_fov_deg` off axis is where the wall
    around the lumen leaves the view of a camera that passes. What lies farther was seen only from afar and is not
    judged. A surface cut from voxels ends up to a voxel short of what was seen, because all eight corners of a cell
    must be known: give that as `fringe` (mesh unit), and wall so near to the mesh's edge counts as seen. Raises
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
    stretch = visited_stretch(line, poses, half_fov_deg)
    inside = (line.arc >= stretch[0]) & (line.arc <= stretch[1])
    if line.wall[inside].mean() < LEAST_WALL:
        raise NotATube(
            f"only {100 * line.wall[inside].mean():.0f} % of the directions around the lumen meet reconstructed wall, "
            "so it is too open to judge"
        )
    line = replace(line, arc=line.arc - stretch[0])
    stretch = (0.0, stretch[1] - stretch[0])
    radius = float(np.median(line.radius[inside]))
    closure = close_wall(own, line, stretch, radius, fringe / scale)
    region, regions = _find_regions(closure, line, poses, half_fov_deg)
    return Coverage(line, closure, region, regions, stretch, radius, unit).transformed(mesh_from_canonical)


def visited_stretch(line: Centreline, poses: Array, half_fov_deg: float) -> tuple[float, float]:
    """First and last arc length at which a cross-section crossed the edge of the picture.

    A camera that looks along the lumen, either way, has at its picture's edge the wall that lies the lumen's radius
    over the tangent of the half angle ahead of it.
    """
    row = line.stations_of(poses[:, :3, 3])
    cosine = np.einsum("ni,ni->n", line.tangents[row], poses[:, :3, 2])
    ahead = np.sign(cosine) * line.radius[row] / np.tan(np.radians(half_fov_deg))
    at_edge = (line.locate(poses[:, :3, 3])[0] + ahead)[np.abs(cosine) >= ALONG]
    if not len(at_edge) or np.ptp(np.clip(at_edge, *line.arc[[0, -1]])) < SHORTEST * np.median(line.radius):
        raise NotATube("the camera hardly moves along the lumen, so there is no stretch to judge")
    low, high = np.clip([at_edge.min(), at_edge.max()], *line.arc[[0, -1]])
    return float(low), float(high)


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
        mean_angle = np.angle(np.sum(areas[rows] * np.exp(1j * closure.angle[rows])))
        clock = float(mean_angle % (2 * np.pi) * 6 / np.pi) or 12.0
        regions.append(
            MissedRegion(
                area=float(areas[rows].sum()),
                arc=float(np.average(closure.arc[rows], weights=areas[rows])),
                arc_range=(float(extent.min()), float(extent.max())),
                clock=clock,
                centre=(float(centre[0]), float(centre[1]), float(centre[2])),
                frame=_nearest_view(centre, poses, half_fov_deg),
            )
        )
    return region, regions


def _nearest_view(point: Array, poses: Array, half_fov_deg: float) -> int:
    """The nearest camera that has the point within its cone of view; the nearest of all where none has."""
    offset = point - poses[:, :3, 3]
    distance = np.linalg.norm(offset, axis=1)
    depth = np.einsum("ni,ni->n", offset, poses[:, :3, 2])
    within = depth >= np.cos(np.radians(half_fov_deg)) * distance
    return int(np.argmin(np.where(within, distance, np.inf) if within.any() else distance))
