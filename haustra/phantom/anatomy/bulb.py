"""Bulbs on a neck, drawn out of the wall: a polyp on its stalk into the lumen, or a diverticulum out of it.

Both overhang, which a height field over the wall cannot represent. The mesh's vertices within a disc of the wall are
moved towards its middle and then along the bulb's profile. The disc is wide, so that the bulb gets enough vertices; in
its outer part they only slide along the wall.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from haustra.phantom.noise import SolidNoise

Array = NDArray[np.float64]
Surface = Callable[[Array, Array], Array]  # arc (mm) and angle (rad), broadcast to (K,L), to points (K,L,3) mm

STRETCH = 1.9  # length of a profile over the radius of the disc that its vertices come from
KNEE = 0.8  # disc radii from which the stretch fades towards the rim
STEP_MM = 0.05  # between a profile's samples
ROUNDING_MM = 0.35  # standard deviation of the smoothing of a profile's corners
LIP_MM = 1.5  # length of flat wall at a profile's end, longer than the smoothing reaches
TANGENT_MM = 1.5  # half baseline of the wall's slope, so that fine relief does not tilt a lesion
LOBES = 0.08  # unevenness of a polyp's head, fraction of its radius


@dataclass(frozen=True)
class Profile:
    """Rotational profile of a bulb on a neck, sampled by distance from its top along the surface, mm."""

    length: Array  # (K,) distance from the top along the surface
    rho: Array  # (K,) lateral radius
    height: Array  # (K,) over the wall
    neck_mm: float  # height at which the neck ends and the bulb starts
    middle_mm: float  # height of the bulb's widest place
    top_mm: float

    @property
    def rim_mm(self) -> float:
        """Lateral radius (mm) beyond which the wall is unchanged."""
        return float(self.rho[-1])

    def radius_at(self, height: float) -> float:
        """Lateral radius (mm) at a height (mm); the height never falls from the rim to the top."""
        return float(np.interp(height, self.height[::-1], self.rho[::-1]))

    @property
    def reach_mm(self) -> float:
        """Radius (mm) of the disc whose vertices form the bulb."""
        return max((float(self.length[-1]) - self.rim_mm) / (STRETCH - 1), 1.3 * self.rim_mm)

    def way(self, part: Array) -> Array:
        """Distance from the top along profile and wall (mm) of a vertex at `part` (0 to 1) of the disc's radius.

        Linear over most of the disc; at the rim, value and slope join those of the unchanged wall.
        """
        ratio = (float(self.length[-1]) - self.rim_mm) / self.reach_mm + 1
        steep = (ratio - 0.5 * (1 - KNEE)) / (0.5 * (1 + KNEE))
        late = np.maximum(part - KNEE, 0.0)
        return self.reach_mm * (steep * part - (steep - 1) * late**2 / (2 * (1 - KNEE)))

    def at(self, way: Array) -> tuple[Array, Array]:
        """Lateral radius and height (mm) at distances from the top (mm); past the rim, of the flat wall."""
        rho = np.interp(way, self.length, self.rho) + np.maximum(way - self.length[-1], 0.0)
        return rho, np.interp(way, self.length, self.height)


def bulb_profile(neck_radius: float, neck: float, bulb_radius: float, bulb_half: float, flare: float) -> Profile:
    """An ellipsoid of half axes bulb_radius and bulb_half on a neck that flares into the wall (all mm)."""
    seam = np.pi - np.arcsin(min(neck_radius / bulb_radius, 1.0))
    middle = neck - bulb_half * np.cos(seam)
    turn = np.linspace(0, seam, 200)
    foot = np.linspace(0, np.pi / 2, 40)
    neck_part = np.linspace(neck, flare, 60)
    lip = neck_radius + flare + np.linspace(0, LIP_MM, 30)
    rho = [bulb_radius * np.sin(turn), np.full(60, neck_radius), neck_radius + flare * (1 - np.cos(foot)), lip]
    height = [middle + bulb_half * np.cos(turn), neck_part, flare * (1 - np.sin(foot)), np.zeros(30)]
    rho_all, height_all = _rounded(np.concatenate(rho), np.concatenate(height))
    length = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(rho_all), np.diff(height_all)))])
    return Profile(length, rho_all, height_all, neck, float(middle), float(height_all[0]))


def _rounded(rho: Array, height: Array) -> tuple[Array, Array]:
    """Resample a polyline evenly and take its corners off; mirrored at the axis, extended straight at the wall."""
    length = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(rho), np.diff(height)))])
    even = np.linspace(0, length[-1], max(2, round(length[-1] / STEP_MM)))
    rho, height = np.interp(even, length, rho), np.interp(even, length, height)
    pad, step = round(2 * LIP_MM / STEP_MM), even[1]
    onward = rho[-1] + step * np.arange(1, pad + 1)
    wide = np.concatenate([-rho[pad:0:-1], rho, onward])
    tall = np.concatenate([height[pad:0:-1], height, np.zeros(pad)])
    kept = slice(pad, pad + len(rho))
    smooth_rho = gaussian_filter1d(wide, ROUNDING_MM / step)[kept]
    smooth_rho[0] = 0.0  # on the axis but for rounding
    return smooth_rho, gaussian_filter1d(tall, ROUNDING_MM / step)[kept]


@dataclass(frozen=True)
class Site:
    """A place on the wall: point (3,) mm, axes (3,3) in columns along, around and inward, and mm per unit of each."""

    arc_mm: float
    angle_rad: float
    centre: Array
    axes: Array
    per_arc: float  # mm of wall per mm of arc length: less on the inside of a bend
    per_rad: float

    def polar(self, arc: Array, angle: Array) -> tuple[Array, Array]:
        """Distance (mm) and direction (rad, 0 along the gut) on the wall, broadcast over arc and angle."""
        along = (arc - self.arc_mm) * self.per_arc
        around = np.angle(np.exp(1j * (angle - self.angle_rad))) * self.per_rad
        return np.hypot(along, around), np.arctan2(around, along)

    def sheet(self, distance: Array, direction: Array) -> tuple[Array, Array]:
        """Inverse of `polar`: arc (mm) and angle (rad)."""
        arc = self.arc_mm + distance * np.cos(direction) / self.per_arc
        return arc, self.angle_rad + distance * np.sin(direction) / self.per_rad


def site_at(surface: Surface, arc: float, angle: float) -> Site:
    """The wall's tangent plane at a place."""
    lumen_mm = np.linalg.norm(_difference(surface, arc, angle, 0.0, np.pi / 2)) / 2
    turn = TANGENT_MM / float(lumen_mm)
    along = _difference(surface, arc, angle, TANGENT_MM, 0.0) / (2 * TANGENT_MM)
    around = _difference(surface, arc, angle, 0.0, turn) / (2 * turn)
    inward = np.cross(along, around)
    inward /= np.linalg.norm(inward)
    ahead = along / np.linalg.norm(along)
    axes = np.stack([ahead, np.cross(inward, ahead), inward], axis=1)
    centre = surface(np.array([[arc]]), np.array([[angle]]))[0, 0]
    return Site(arc, angle, centre, axes, float(np.linalg.norm(along)), float(np.linalg.norm(around)))


def _difference(surface: Surface, arc: float, angle: float, along: float, turn: float) -> Array:
    """Vector (3,) mm between the wall's points one step (mm, rad) before and one behind a place."""
    sign = np.array([[1.0], [-1.0]])
    ahead, behind = surface(arc + along * sign, angle + turn * sign)[:, 0]
    return np.asarray(ahead - behind)


@dataclass(frozen=True)
class Bulb:
    """A polyp's stalk and head (`side` 1, into the lumen) or a diverticulum (`side` -1)."""

    site: Site
    profile: Profile
    side: float
    lean_rad: float  # how far the neck bends over
    heading_rad: float  # direction on the wall it leans to
    lobes: SolidNoise | None  # unevenness of the bulb

    def part(self, arc: Array, angle: Array) -> tuple[Array, Array]:
        """Distance from the centre as fraction of the disc, and direction (rad)."""
        distance, direction = self.site.polar(arc, angle)
        return distance / self.profile.reach_mm, direction

    def gathered(self, part: Array, direction: Array) -> tuple[Array, Array]:
        """Arc length (mm) and angle (rad) on the unchanged wall that the disc's vertices slide to."""
        rho, _ = self.profile.at(self.profile.way(part))
        return self.site.sheet(rho, direction)

    def drawn_out(self, wall: Array, part: Array, direction: Array) -> Array:
        """Final vertices (...,3) mm of those that `gathered` moved along the wall (...,3)."""
        way = self.profile.way(part)
        rho, height = self.profile.at(way)
        inward = self.side * height[..., None] * self.site.axes[:, 2]
        rigid = ease((self.profile.length[-1] - way) / (2.5 * LIP_MM))[..., None]
        return (1 - rigid) * (wall + inward) + rigid * self.body(rho, height, direction)

    def body(self, rho: Array, height: Array, direction: Array) -> Array:
        """Points (...,3) mm of the bulb on a plane wall; the neck bends in an arc, the head follows rigidly."""
        rho, height, direction = np.broadcast_arrays(rho, height, direction)
        rho, height = self._uneven(rho, height, direction)
        neck, lean = self.profile.neck_mm, max(self.lean_rad, 1e-6)
        tilt = lean * np.clip(height / neck, 0, 1)
        over = np.maximum(height - neck, 0.0)
        axis_x = neck / lean * (1 - np.cos(tilt)) + over * np.sin(tilt)
        axis_z = neck / lean * np.sin(tilt) + over * np.cos(tilt)
        x, y = rho * np.cos(direction - self.heading_rad), rho * np.sin(direction - self.heading_rad)
        x, z = axis_x + x * np.cos(tilt), self.side * (axis_z - x * np.sin(tilt))
        cosine, sine = np.cos(self.heading_rad), np.sin(self.heading_rad)
        local = np.stack([x * cosine - y * sine, x * sine + y * cosine, z], axis=-1)
        return self.site.centre + local @ self.site.axes.T

    def _uneven(self, rho: Array, height: Array, direction: Array) -> tuple[Array, Array]:
        """Radius and height with the bulb's lobes."""
        if self.lobes is None:
            return rho, height
        above = height - self.profile.middle_mm
        place = np.stack([rho * np.cos(direction), rho * np.sin(direction), above], axis=-1)
        bulb = ease((height - self.profile.neck_mm) / (self.profile.middle_mm - self.profile.neck_mm))
        swell = 1 + LOBES * bulb * np.clip(self.lobes(place.astype(np.float32)), -2, 2)
        return rho * swell, self.profile.middle_mm + above * swell

    def cover(self, part: Array) -> Array:
        """Polyp cover in [0,1]: 1 on the head, falling to 0 down the stalk; 0 on a diverticulum."""
        if self.side < 0:
            return np.zeros_like(part)
        height = self.profile.at(self.profile.way(part))[1] / self.profile.neck_mm
        return ease((height - 0.3) / 0.6)


def ease(part: Array) -> Array:
    """Smooth step from 0 to 1."""
    part = np.clip(part, 0, 1)
    return part * part * (3 - 2 * part)
