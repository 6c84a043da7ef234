"""Lesions and their placement: polyps by Paris class, and diverticula.

Sessile (Is) and flat (IIa) polyps are bumps of the wall's height. Polyps on a stalk (Ip) and diverticula are bulbs
(`anatomy.bulb`). Each kind draws from a random generator of its own, so that more of one kind does not move the others,
unless they would overlap.

Paris classification: Gastrointest Endosc 58 (2003) S3-S43. Diverticula: mouths of some 5 mm, pouches to 10 mm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from haustra.core.errors import PhantomError
from haustra.phantom.anatomy.bulb import Bulb, Profile, Site, Surface, bulb_profile, site_at
from haustra.phantom.config import AnatomyConfig
from haustra.phantom.noise import SolidNoise

Array = NDArray[np.float64]

TRIES = 400  # random places per lesion before it is given up
SKIRT = 1.3  # radii at which a bump has faded
GAP_MM = 1.2  # least distance between a bulb and any wall but that at its root
ROOT_MM = 2.2  # height of a bulb's root, within which it is near its own wall
UNEVEN_MM = 0.5  # largest deviation from a plane of the wall under a bulb's foot, plus UNEVEN times the foot's radius
POUCH_FLARE_MM = 1.0  # rounding of a diverticulum's edge
UNEVEN = 0.25  # see UNEVEN_MM; keeps bulbs off folds


@dataclass(frozen=True)
class Polyp:
    """Where a polyp sits, in the sheet and in space, and how big it is."""

    arc_mm: float
    angle_rad: float
    radius_mm: float  # of the base; on a stalk, of the head
    height_mm: float
    apex: tuple[float, float, float] = (0.0, 0.0, 0.0)  # a vertex of the mesh
    kind: str = "sessile"  # "sessile" (Paris Is), "flat" (IIa) or "pedunculated" (Ip)

    def bump(self, arc: Array, angle: Array, radius_mm: float) -> Array:
        """Height over `height_mm` (0 to 1) at arc (mm) and angle (rad) in a lumen of radius `radius_mm`."""
        around = np.angle(np.exp(1j * (angle - self.angle_rad))) * radius_mm
        distance = np.hypot(arc - self.arc_mm, around) / self.radius_mm
        return np.exp(-(distance ** (6 if self.kind == "flat" else 4)))  # flat top, steep side


@dataclass(frozen=True)
class Diverticulum:
    """A pouch through the wall."""

    arc_mm: float
    angle_rad: float
    mouth_radius_mm: float
    depth_mm: float
    centre: tuple[float, float, float]  # of the mouth, in the plane of the wall around it


@dataclass(frozen=True)
class Footprint:
    """An ellipse on the unrolled sheet that a lesion occupies."""

    arc_mm: float
    angle_rad: float
    half_arc_mm: float
    half_angle_rad: float

    def meets(self, other: Footprint) -> bool:
        """Whether the two overlap, with a tenth to spare."""
        along = (self.arc_mm - other.arc_mm) / (self.half_arc_mm + other.half_arc_mm)
        turn = np.angle(np.exp(1j * (self.angle_rad - other.angle_rad)))
        return bool(np.hypot(along, turn / (self.half_angle_rad + other.half_angle_rad)) < 1.1)


def place_sessile(anatomy: AnatomyConfig, rng: np.random.Generator) -> list[Polyp]:
    """Sessile polyps at random places of the wall, folds included."""
    low, high = _stretch_of_gut(anatomy)
    arcs = rng.uniform(low, high, anatomy.polyps)
    sizes = anatomy.polyp_radius_mm * rng.uniform(0.6, 1.5, anatomy.polyps)
    angles, flatness = rng.uniform(0, 2 * np.pi, anatomy.polyps), rng.uniform(0.5, 1.0, anatomy.polyps)
    return [Polyp(float(a), float(t), float(r), float(r * f)) for a, t, r, f in zip(arcs, angles, sizes, flatness)]


def place_flat(anatomy: AnatomyConfig, others: list[Polyp], rng: np.random.Generator) -> list[Polyp]:
    """Flat polyps that overlap neither `others` nor each other; they may lie on folds."""
    taken = [bump_footprint(polyp, anatomy) for polyp in others]
    placed: list[Polyp] = []
    for _ in range(anatomy.flat):
        radius = float(anatomy.polyp_radius_mm * rng.uniform(1.5, 2.5))
        height = float(rng.uniform(0.5, 1.2))
        for _ in range(TRIES):
            arc, angle = rng.uniform(*_stretch_of_gut(anatomy)), rng.uniform(0, 2 * np.pi)
            polyp = Polyp(float(arc), float(angle), radius, height, kind="flat")
            footprint = bump_footprint(polyp, anatomy)
            if not any(footprint.meets(other) for other in taken):
                break
        else:
            raise PhantomError(f"no room for {anatomy.flat} flat polyps in a gut of {anatomy.length_mm:.0f} mm")
        placed.append(polyp)
        taken.append(footprint)
    return placed


def bump_footprint(polyp: Polyp, anatomy: AnatomyConfig) -> Footprint:
    """Footprint of a sessile or flat polyp out to its skirt."""
    reach = SKIRT * polyp.radius_mm
    return Footprint(polyp.arc_mm, polyp.angle_rad, reach, reach / anatomy.radius_mm)


def _stretch_of_gut(anatomy: AnatomyConfig) -> tuple[float, float]:
    """Arc lengths (mm) between which lesions may lie, away from the ends."""
    margin = min(30.0, 0.2 * anatomy.length_mm)
    return margin, anatomy.length_mm - margin


@dataclass
class BulbPlacer:
    """Rejection sampling of places where a bulb stands on plane wall and touches no fold, wall or lesion."""

    surface: Surface
    anatomy: AnatomyConfig
    obstacles: list[cKDTree]  # points of the wall, about a millimetre apart, and of the bulbs placed so far
    taken: list[Footprint] = field(default_factory=list)

    def polyps(self, rng: np.random.Generator) -> list[Bulb]:
        """Polyps on stalks."""
        return [self._place(rng, self._stalked, 1.0, "polyps on stalks") for _ in range(self.anatomy.pedunculated)]

    def diverticula(self, rng: np.random.Generator) -> list[Bulb]:
        """Diverticula."""
        return [self._place(rng, self._pouch, -1.0, "diverticula") for _ in range(self.anatomy.diverticula)]

    def _stalked(self, rng: np.random.Generator) -> tuple[Profile, float, SolidNoise | None]:
        """Profile, lean (rad) and lobes of a polyp's stalk and head."""
        head = self.anatomy.polyp_radius_mm * rng.uniform(0.85, 1.15)
        stalk = min(rng.uniform(1.0, 2.0), 0.6 * head)  # radius: stalks are 2 to 4 mm thick
        length = rng.uniform(4.0, np.clip(0.45 * self.anatomy.radius_mm, 4.0, 10.0))
        profile = bulb_profile(stalk, length, head, head * rng.uniform(0.75, 0.95), flare=1.5)
        return profile, rng.uniform(0.0, 0.9), SolidNoise(2.0 * head, 0.9 * head, rng)

    def _pouch(self, rng: np.random.Generator) -> tuple[Profile, float, SolidNoise | None]:
        """Profile of a diverticulum: a mouth, a slightly narrower neck, a wider pouch."""
        mouth = self.anatomy.diverticulum_mm * rng.uniform(0.85, 1.15)
        depth, neck = np.clip(mouth * rng.uniform(1.6, 2.6), 4.0, 9.0), rng.uniform(1.3, 1.8)
        narrow = mouth - (1 - np.sqrt(0.75)) * POUCH_FLARE_MM  # the mouth is measured half way down its edge
        wide = narrow * rng.uniform(1.35, 1.6)
        half = (depth - neck) / (1 + np.sqrt(1 - (narrow / wide) ** 2))
        return bulb_profile(narrow, neck, wide, half, POUCH_FLARE_MM), 0.0, None

    def _place(
        self,
        rng: np.random.Generator,
        draw: Callable[[np.random.Generator], tuple[Profile, float, SolidNoise | None]],
        side: float,
        name: str,
    ) -> Bulb:
        """A bulb of the shape that `draw` gives at the first free place; PhantomError after TRIES."""
        profile, lean, lobes = draw(rng)
        for _ in range(TRIES):
            arc, angle, heading = rng.uniform(*_stretch_of_gut(self.anatomy)), *rng.uniform(0, 2 * np.pi, 2)
            site = site_at(self.surface, float(arc), float(angle))
            bulb = Bulb(site, profile, side, float(lean), float(heading), lobes)
            if (footprint := self._free(site, profile)) and self._plane(bulb) and self._clear(bulb):
                self.taken.append(footprint)
                self.obstacles.append(cKDTree(_outline(bulb)))
                return bulb
        length, radius = self.anatomy.length_mm, self.anatomy.radius_mm
        raise PhantomError(f"no room for all {name} in a gut {length:.0f} mm long and {radius:.0f} mm in radius")

    def _free(self, site: Site, profile: Profile) -> Footprint | None:
        """Footprint of the bulb's disc if it is away from the gut's ends and overlaps no other; else None."""
        half_arc, half_angle = profile.reach_mm / site.per_arc, profile.reach_mm / site.per_rad
        low, high = site.arc_mm - half_arc, self.anatomy.length_mm - site.arc_mm - half_arc
        cap = 0.5 * self.anatomy.radius_mm
        if low < (cap if self.anatomy.closed_start else 2) or high < (cap if self.anatomy.closed_end else 2):
            return None
        footprint = Footprint(site.arc_mm, site.angle_rad, half_arc, half_angle)
        meets = half_angle > 0.9 * np.pi or any(footprint.meets(other) for other in self.taken)
        return None if meets else footprint

    def _plane(self, bulb: Bulb) -> bool:
        """Whether the wall under the foot deviates little from its tangent plane."""
        foot = bulb.profile.rim_mm
        direction = np.linspace(0, 2 * np.pi, 12, endpoint=False)[None, :]
        wall = self.surface(*bulb.site.sheet(foot * np.array([[0.5], [1.0]]), direction))
        off = (wall - bulb.site.centre) @ bulb.site.axes[:, 2]
        return bool(np.abs(off).max() < UNEVEN_MM + UNEVEN * foot)

    def _clear(self, bulb: Bulb) -> bool:
        """Whether the bulb keeps GAP_MM from every obstacle."""
        outline = _outline(bulb)
        near = [tree.query(outline, distance_upper_bound=GAP_MM)[0] for tree in self.obstacles]
        return not np.isfinite(near).any()


def _outline(bulb: Bulb) -> Array:
    """Points (K,3) of the bulb beyond its root, less than a millimetre apart."""
    way = np.arange(0.0, bulb.profile.length[-1], 0.7)
    rho, height = bulb.profile.at(way)
    far = height > ROOT_MM
    direction = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    return bulb.body(rho[far, None], height[far, None], direction[None, :]).reshape(-1, 3)
