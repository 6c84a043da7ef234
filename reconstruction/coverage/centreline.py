"""Centreline of a reconstructed lumen by arc length, with a rotation-minimizing frame.

The cameras were inside the lumen, so their path and the free space ahead of them order it from end to end, however
many holes the mesh has. Cross-sections of the mesh then centre that rough line. Each station carries two axes square to
the line, turned along it as little as possible: Wang et al., "Computation of rotation minimizing frames", TOG 2008
(double reflection). Angles about the line are measured from them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import ReconstructionError
from haustra.core.sim3 import scale_of
from reconstruction.coverage.path_ordering import ordered_path
from reconstruction.coverage.wall_rays import WallRays
from reconstruction.mesh.surface_mesh import SurfaceMesh

Array = NDArray[np.float64]

# Lengths are in lumen radii.
STEP = 0.1  # between stations
INNER_CELL = 0.3  # edge of the cubes that keep one inner point each
MAX_AHEAD = 2.0  # free space in front of a camera that is taken into the line
CLEARANCE = 0.5  # kept from the wall ahead by it
MAX_WALL_DISTANCE = 3.0  # of a cross-section's ray, beyond which it went through a hole
END_EXTENSION = 0.5  # by which the rough line is continued at either end
SMOOTHING = 0.6  # standard deviation along the line; folds, one to three radii apart, must not bend it
CENTRING_ITERATIONS = 5  # the line moves by less than a hundredth of the radius after four
DIRECTIONS = 60  # rays of a cross-section
SPHERE_DIRECTIONS = 200  # in which a camera measures the lumen
MAX_CAMERAS = 150  # that measure the lumen
TUBE_RATIO = 1.15  # median distance of a tube's wall over all directions from its middle, over its radius
MIN_WALL = 0.4  # share of a cross-section's rays that must meet wall before it may centre the line
MIN_STATIONS = 4  # of a line
STANDSTILL = "the camera hardly moves along the lumen, so there is no stretch to judge"
MAX_OFF_LINE = 1.5  # distance of a camera from the line above which it is on a limb that the line leaves out
MAX_OFF_LINE_SHARE = 0.02  # share of such cameras above which the line is refused


class NotATube(ReconstructionError):
    """The mesh does not surround the cameras' path; the text says in one sentence what is lacking."""


@dataclass(frozen=True)
class Centreline:
    """Stations at even steps of arc length, in the mesh's unit and axes.

    The tangent points the way the cameras mostly looked; `twelve` and `three` are 12 and 3 o'clock seen along it.
    """

    arc: Array  # (S,)
    points: Array  # (S,3)
    tangents: Array  # (S,3) unit vectors
    twelve: Array  # (S,3) unit, square to the tangent
    radius: Array  # (S,) median distance to the wall, smoothed along the line
    wall: Array  # (S,) share in [0,1] of a cross-section's rays that meet the mesh

    @property
    def three(self) -> Array:
        """(S,3) unit vectors; forward x up is right in axes with x right, y down and z forward."""
        return np.cross(self.tangents, self.twelve)

    @property
    def step(self) -> float:
        """Arc length between stations."""
        return float(self.arc[1] - self.arc[0])

    def transformed(self, target_from_line: Array) -> Centreline:
        """A copy moved by a Sim(3), given as (4,4) with scale times rotation in its upper left."""
        linear = target_from_line[:3, :3]
        scale = float(scale_of(linear))
        return Centreline(
            scale * self.arc,
            self.points @ linear.T + target_from_line[:3, 3],
            self.tangents @ linear.T / scale,
            self.twelve @ linear.T / scale,
            scale * self.radius,
            self.wall,
        )

    def stations_of(self, points: Array) -> NDArray[np.int64]:
        """Row (N,) of the station nearest to each point (N,3)."""
        from scipy.spatial import cKDTree

        return np.asarray(cKDTree(self.points).query(points, workers=-1)[1], np.int64)

    def locate(self, points: Array) -> tuple[Array, Array, Array]:
        """Cylindrical coordinates (N,) of points (N,3): arc length, angle and distance from the line.

        The angle is in radians, 0 at 12 o'clock, growing clockwise, in [0, 2 pi). A point past an end of the line gets
        an arc length past it.
        """
        row = self.stations_of(points)
        offset = points - self.points[row]
        along = np.einsum("ni,ni->n", offset, self.tangents[row])
        low = np.where(row == 0, -np.inf, -self.step / 2)
        high = np.where(row == len(self.arc) - 1, np.inf, self.step / 2)
        up = np.einsum("ni,ni->n", offset, self.twelve[row])
        right = np.einsum("ni,ni->n", offset, self.three[row])
        return self.arc[row] + np.clip(along, low, high), np.arctan2(right, up) % (2 * np.pi), np.hypot(up, right)


def lumen_radius(walls: WallRays, world_from_camera: Array) -> float:
    """Lumen radius: median distance of the wall over all directions from the cameras (N,4,4), over TUBE_RATIO."""
    step = -(-len(world_from_camera) // MAX_CAMERAS)
    thinned = world_from_camera[::step]
    directions = np.einsum("nij,kj->nki", thinned[:, :3, :3], _sphere(SPHERE_DIRECTIONS))
    distance = walls.distance(thinned[:, None, :3, 3], directions)
    if not np.isfinite(distance).any():
        raise NotATube("no camera has reconstructed wall around it, so there is no lumen to judge")
    radius = float(np.median(distance[np.isfinite(distance)])) / TUBE_RATIO
    if radius == 0:
        raise NotATube("the cameras lie on the reconstructed wall, so there is no lumen to judge")
    return radius


def trace_centreline(mesh: SurfaceMesh, world_from_camera: Array, radius: float) -> Centreline:
    """Centreline of the lumen that the cameras (N,4,4) went along; `radius` as `lumen_radius` gives it.

    Arc length is 0 at the end that the cameras look away from. Raises `NotATube` where the mesh surrounds none of it.
    """
    walls = WallRays(mesh)
    rough = _ordered(walls, _inner_points(walls, world_from_camera, radius), radius)
    line = _resampled(_extended(rough, END_EXTENSION * radius), STEP * radius)
    for _ in range(CENTRING_ITERATIONS):
        line = _resampled(_centred(walls, line, radius), STEP * radius)
    _refuse_shortcut(line, world_from_camera[:, :3, 3], radius)
    line = _along_view(line, world_from_camera)
    tangents = _tangents(line)
    first = int(np.argmin(np.linalg.norm(world_from_camera[:, :3, 3] - line[0], axis=1)))
    twelve = _transported(line, tangents, -world_from_camera[first, :3, 1])
    around, met = _cross_sections(walls, line, tangents, radius)
    width = np.array([float(np.median(r[h])) if h.any() else radius for r, h in zip(around, met, strict=True)])
    arc, share = STEP * radius * np.arange(len(line), dtype=np.float64), met.mean(axis=1).astype(np.float64)
    return Centreline(arc, line, tangents, twelve, _smoothed(width, share + 1e-3), share)


def _along_view(line: Array, world_from_camera: Array) -> Array:
    """The line (S,3), reversed if most cameras look against it."""
    from scipy.spatial import cKDTree

    row = cKDTree(line).query(world_from_camera[:, :3, 3])[1]
    looks = np.einsum("ni,ni->n", _tangents(line)[row], world_from_camera[:, :3, 2])
    return line[::-1] if looks.sum() < 0 else line


def _sphere(count: int) -> Array:
    """Unit vectors (count,3) spread evenly over the sphere: a Fibonacci lattice."""
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    return np.column_stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])


def _inner_points(walls: WallRays, world_from_camera: Array, radius: float) -> Array:
    """Points (M,3) inside the lumen: the cameras (N,4,4) and the free space ahead of each, one mean per cube."""
    centres, forward = world_from_camera[:, :3, 3], world_from_camera[:, :3, 2]
    free = np.minimum(walls.distance(centres, forward) - CLEARANCE * radius, MAX_AHEAD * radius)
    steps = np.arange(0, MAX_AHEAD, STEP) * radius
    ahead = centres[:, None] + steps[:, None] * forward[:, None]
    points = np.concatenate([centres, ahead[steps < free[:, None]]])
    # Rounded, not floored: a straight path along an axis would otherwise lie on the border of cubes.
    cube = np.rint(points / (INNER_CELL * radius)).astype(np.int64)
    _, owner, count = np.unique(cube, axis=0, return_inverse=True, return_counts=True)
    mean = np.zeros((len(count), 3))
    np.add.at(mean, owner.ravel(), points)
    return mean / count[:, None]


def _ordered(walls: WallRays, points: Array, radius: float) -> Array:
    """Inner points in the order of the path through the lumen; `NotATube` if it is shorter than a radius."""
    path = ordered_path(walls, points, radius)
    if np.linalg.norm(np.diff(path, axis=0), axis=1).sum() < radius:
        raise NotATube(STANDSTILL)
    return path


def _refuse_shortcut(line: Array, centres: Array, radius: float) -> None:
    """Raise `NotATube` where camera centres (N,3) lie on a limb that the line leaves out: its wall would be missing."""
    from scipy.spatial import cKDTree

    off_line = float((cKDTree(line).query(centres)[0] > MAX_OFF_LINE * radius).mean())
    if off_line > MAX_OFF_LINE_SHARE:
        share = f"{100 * off_line:.0f} % of the camera's way"
        raise NotATube(f"the lumen's middle line leaves {share} aside, so coverage cannot be judged")


def _extended(line: Array, length: float) -> Array:
    """The polyline continued straight past both ends, which thinning and smoothing cut short of the cameras."""
    first, last = line[0] - line[1], line[-1] - line[-2]
    ends = line[[0, -1]] + length * np.stack([first / np.linalg.norm(first), last / np.linalg.norm(last)])
    return np.concatenate([ends[:1], line, ends[1:]])


def _resampled(line: Array, step: float) -> Array:
    """The polyline at even steps (S,3); a rest shorter than `step` at the end is cut."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    places = np.arange(0, arc[-1], step)
    if len(places) < MIN_STATIONS:
        raise NotATube(STANDSTILL)
    return np.column_stack([np.interp(places, arc, line[:, axis]) for axis in range(3)])


def _centred(walls: WallRays, line: Array, radius: float) -> Array:
    """One centring iteration: stations moved to the centroid of their cross-section, weighted by its wall, smoothed."""
    smooth = _smoothed(line, np.ones(len(line)))
    tangents = _tangents(smooth)
    first, second = _frame(smooth, tangents)
    around, met = _cross_sections(walls, smooth, tangents, radius)
    trust = np.where(met.mean(axis=1) >= MIN_WALL, met.mean(axis=1), 0)
    if not trust.any():
        raise NotATube("the reconstructed wall nowhere surrounds the camera's path, so it is too open to judge")
    angle = np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS
    middle = np.array([np.median(r[h]) if h.any() else 0 for r, h in zip(around, met, strict=True)])
    # A gap in the wall is taken at the section's median distance, so that it neither attracts nor repels.
    filled = np.where(met, around, middle[:, None])
    area = np.maximum((filled**2).sum(axis=1), 1e-12)
    right, up = ((filled**3 * weight).sum(axis=1) / area * 2 / 3 for weight in (np.cos(angle), np.sin(angle)))
    shift = right[:, None] * first + up[:, None] * second
    return smooth + _smoothed(shift, trust + 1e-3)


def _cross_sections(walls: WallRays, line: Array, tangents: Array, radius: float) -> tuple[Array, NDArray[np.bool_]]:
    """Distance of the wall (S, DIRECTIONS) square to the line, and where there is one within MAX_WALL_DISTANCE."""
    first, second = _frame(line, tangents)
    angle = np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS
    rays = np.cos(angle)[:, None] * first[:, None] + np.sin(angle)[:, None] * second[:, None]
    distance = walls.distance(line[:, None], rays)
    return distance, distance <= MAX_WALL_DISTANCE * radius


def _smoothed(values: Array, weight: Array) -> Array:
    """Weighted Gaussian smoothing of values (S,...) along the stations, weights (S,).

    Ends are continued by point reflection, so that a straight end stays where it is.
    """
    from scipy.ndimage import gaussian_filter1d

    pad = min(len(values) - 1, round(3 * SMOOTHING / STEP))
    front = 2 * values[:1] - values[pad:0:-1]
    back = 2 * values[-1:] - values[-2 : -pad - 2 : -1]
    long = np.concatenate([front, values, back])
    heavy = np.pad(weight, pad, mode="reflect").reshape(-1, *[1] * (values.ndim - 1))
    sigma = SMOOTHING / STEP
    mean = gaussian_filter1d(long * heavy, sigma, axis=0, mode="nearest")
    return (mean / gaussian_filter1d(heavy, sigma, axis=0, mode="nearest"))[pad : pad + len(values)]


def _tangents(line: Array) -> Array:
    """Unit tangents (S,3) by central differences."""
    slope = np.gradient(line, axis=0)
    return slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-12)


def _frame(line: Array, tangents: Array) -> tuple[Array, Array]:
    """Two axes (S,3) square to the line and to each other, without twist; where they begin is arbitrary."""
    first = _transported(line, tangents, np.eye(3)[np.abs(tangents[0]).argmin()])
    return first, np.cross(tangents, first)


def _transported(line: Array, tangents: Array, up: Array) -> Array:
    """Parallel transport of `up` (3,), made square to the first tangent, by double reflection: (S,3) unit vectors."""
    axis = up - (up @ tangents[0]) * tangents[0]
    if np.linalg.norm(axis) < 1e-6:
        axis = np.cross(tangents[0], np.eye(3)[np.abs(tangents[0]).argmin()])
    transported = [axis / np.linalg.norm(axis)]
    for chord, here, there in zip(np.diff(line, axis=0), tangents[:-1], tangents[1:], strict=True):
        mirrored, tangent = (v - 2 * (chord @ v) / (chord @ chord) * chord for v in (transported[-1], here))
        bend = there - tangent
        across = mirrored - 2 * (bend @ mirrored) / max(float(bend @ bend), 1e-300) * bend
        across -= (across @ there) * there
        transported.append(across / np.linalg.norm(across))
    return np.array(transported)
