"""The wall of the gut as a parametric surface of arc length and angle; overhanging bulbs are added in `colon`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import PhantomError
from haustra.phantom.anatomy.bulb import ease
from haustra.phantom.anatomy.centreline import LONG_AXIS, Centreline
from haustra.phantom.anatomy.folds import Fold, fold_relief, measure_gaps, straightened
from haustra.phantom.anatomy.lesions import Polyp
from haustra.phantom.config import AnatomyConfig
from haustra.phantom.noise import SolidNoise, path_noise

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
END_OPENING = 0.04  # radius of the open ends over the lumen's
CAP_ROUND = np.pi / 2 - 1  # length of a quarter circle less its radius, in radii
GAP_STEP_MM = 0.25  # sampling along the wall for gaps; 0.5 mm misses corners of rims cut off at the least radius
GAP_ANGLES = 72  # angles at which gaps between folds are measured: folds change over 50 degrees and more
VILLI_MM = (3.0, 1.5)  # wavelengths; shorter ones fall between the vertices and belong to the texture's bump
VILLI_STD = 0.5  # 0.35 is a wave's standard deviation per height; looking up between voxels flattens waves this short


class Wall:
    """A surface over arc length (mm) and angle (rad). `rng` continues the gut's first stream of random numbers."""

    def __init__(
        self,
        anatomy: AnatomyConfig,
        line: Centreline,
        folds: list[Fold],
        polyps: list[Polyp],
        rng: np.random.Generator,
        own_rng: np.random.Generator,
    ) -> None:
        self.anatomy, self.line, self.folds, self.polyps = anatomy, line, folds, polyps
        self._knots = np.arange(0.0, anatomy.length_mm + 2.0)
        self._widening = 1 + anatomy.radius_variation * path_noise(len(self._knots), 80.0, rng)
        self._relief = _Relief(anatomy, rng, own_rng)
        self._collapse = _Collapse(self._knots, anatomy, own_rng) if anatomy.collapse else None
        self._part_folds()

    def __call__(self, arc: Array, angle: Array) -> tuple[Array, Array]:
        """Points (...,3) mm and polyp cover (...) in [0,1], broadcast over two-dimensional arc and angle."""
        radius, shift, cover = self.evaluate(arc, angle)
        relief = self._relief(self._wrap(arc, arc + shift, angle, radius).astype(np.float32))
        radius = radius * (1 + relief / self.anatomy.radius_mm)
        along = arc + shift
        if self.anatomy.closed_start or self.anatomy.closed_end:
            along = along + relief * _cap_slope(arc, self.anatomy)  # on a cap outwards is along the gut
        return self._wrap(arc, along, angle, radius), cover

    def _part_folds(self) -> None:
        """Reduce the lean of folds until no two come too near each other; most guts need no change."""
        arc = arc_at(np.arange(0.0, unrolled_length(self.anatomy), GAP_STEP_MM), self.anatomy)
        angle = np.linspace(0, 2 * np.pi, GAP_ANGLES, endpoint=False)
        while True:
            radius, shift, _ = self.evaluate(arc[:, None], angle[None, :])
            gaps = measure_gaps(arc, arc[:, None] + shift, radius).narrow()
            if len(gaps.left) == 0:
                return
            ends = gaps.before_mm, gaps.behind_mm
            weights = _cap(ends[0], self.anatomy), _cap(ends[1], self.anatomy)
            self.folds = straightened(self.folds, *ends, weights, angle[gaps.column], self.anatomy)

    def points(self, arc: Array, angle: Array) -> Array:
        """Points alone."""
        return self(arc, angle)[0]

    def evaluate(self, arc: Array, angle: Array) -> tuple[Array, Array, Array]:
        """Radius (mm), shift along the lumen (mm) and polyp cover (0 to 1), broadcast over arc and angle."""
        anatomy = self.anatomy
        radius = anatomy.radius_mm * np.interp(arc, self._knots, self._widening) + 0 * angle
        if anatomy.scene == "colon":
            twist = np.radians(anatomy.taenia_twist_deg_per_mm) * arc
            radius = radius - anatomy.taenia_depth_mm * (0.5 + 0.5 * np.cos(3 * (angle - twist))) ** 2
        inward, shift = fold_relief(self.folds, arc, angle, anatomy)
        radius = np.maximum(radius - inward, 0.3 * anatomy.radius_mm)
        cover = np.zeros_like(radius)
        for polyp in self.polyps:
            bump = polyp.bump(arc, angle, anatomy.radius_mm)
            radius, cover = radius - polyp.height_mm * bump, np.maximum(cover, bump)
        return radius * _pinch(arc, anatomy) * _cap(arc, anatomy), shift * _cap(arc, anatomy), cover

    def _wrap(self, arc: Array, along: Array, angle: Array, radius: Array) -> Array:
        """Cylinder coordinates around the centreline to points (...,3); `along` is `arc` with what shifts it."""
        line = self.line
        centre, frame = line.at(np.clip(along, 0, line.arc[-1]))
        x, y = np.cos(angle), np.sin(angle)
        if self._collapse:
            x, y = self._collapse(along, x, y)  # at `along`: rims lean over wall of another arc length
        outward = x[..., None] * frame[..., 0] + y[..., None] * frame[..., 1]
        beyond = along - np.clip(along, 0, line.arc[-1])  # leaning folds at an open end keep their shape
        return centre + radius[..., None] * outward + beyond[..., None] * frame[..., 2]


class _Relief:
    """Undulation of the wall (mm) at three scales, smaller ones shallower; in the small intestine also villi."""

    def __init__(self, anatomy: AnatomyConfig, rng: np.random.Generator, own_rng: np.random.Generator) -> None:
        bands = [(40.0, 9.0, 1.0), (9.0, 4.0, 0.16), (4.0, 2.0, 0.04)]
        self._relief_mm = anatomy.relief_mm
        self._layers = [(amplitude, SolidNoise(big, small, rng)) for big, small, amplitude in bands]
        self._velvet_mm = VILLI_STD * anatomy.villi_mm
        self._velvet = SolidNoise(*VILLI_MM, own_rng) if anatomy.villi_mm else None

    def __call__(self, points: Floats) -> Floats:
        """Values (...) outwards at points (...,3)."""
        relief = self._relief_mm * np.sum([amplitude * noise(points) for amplitude, noise in self._layers], axis=0)
        return relief + self._velvet_mm * self._velvet(points) if self._velvet else relief


class _Collapse:
    """Collapse of the lumen: an affine map of cross-sections, so that a ring cannot intersect itself."""

    def __init__(self, knots: Array, anatomy: AnatomyConfig, rng: np.random.Generator) -> None:
        wave = path_noise(len(knots), 90.0, rng)
        inner = (knots > 0.2 * knots[-1]) & (knots < 0.8 * knots[-1])  # the flattest place is not hidden in an end
        part = np.clip((wave - np.median(wave[inner])) / (wave[inner].max() - np.median(wave[inner])), 0, 1)
        ends = np.clip(np.minimum(knots, knots[-1] - knots) / (0.2 * knots[-1]), 0, 1)
        self._knots, self._depth = knots, anatomy.collapse * ease(part) * ease(ends)
        self._heading = rng.uniform(0, np.pi) + 0.5 * np.pi * path_noise(len(knots), 150.0, rng)

    def __call__(self, arc: Array, x: Array, y: Array) -> tuple[Array, Array]:
        """Coordinates in the cross-section after it was pressed together at arc (mm)."""
        depth = np.interp(arc, self._knots, self._depth)
        heading = np.interp(arc, self._knots, self._heading)
        short, long = x * np.cos(heading) + y * np.sin(heading), y * np.cos(heading) - x * np.sin(heading)
        short, long = (1 - depth) * short, (1 + LONG_AXIS * depth) * long
        return short * np.cos(heading) - long * np.sin(heading), short * np.sin(heading) + long * np.cos(heading)


def _pinch(arc: Array, anatomy: AnatomyConfig) -> Array:
    """Factor on the radius that narrows the lumen towards open ends, so that little is seen through them."""
    before = np.inf if anatomy.closed_start else arc
    behind = np.inf if anatomy.closed_end else anatomy.length_mm - arc
    part = np.clip(np.minimum(before, behind) / anatomy.pinch_mm, 0, 1)
    return END_OPENING + (1 - END_OPENING) * np.sin(0.5 * np.pi * part)


def _cap(arc: Array, anatomy: AnatomyConfig) -> Array:
    """Factor on the radius that makes blind ends half spheres; 1 elsewhere."""
    before = arc if anatomy.closed_start else np.inf
    behind = anatomy.length_mm - arc if anatomy.closed_end else np.inf
    part = np.clip(np.minimum(before, behind) / anatomy.radius_mm, 0, 1)
    return np.sqrt(part * (2 - part))


def _cap_slope(arc: Array, anatomy: AnatomyConfig) -> Array:
    """Component along the gut of the cap's outward normal: -1 at the pole it starts from, 1 at the one it ends in."""
    before = 1 - np.clip(arc / anatomy.radius_mm, 0, 1) if anatomy.closed_start else 0.0
    behind = 1 - np.clip((anatomy.length_mm - arc) / anatomy.radius_mm, 0, 1) if anatomy.closed_end else 0.0
    return np.asarray(behind - before)


def unrolled_length(anatomy: AnatomyConfig) -> float:
    """Length (mm) of a smooth wall along the gut, half-spherical ends included."""
    caps = anatomy.closed_start + anatomy.closed_end
    if caps * anatomy.radius_mm > anatomy.length_mm:
        raise PhantomError(
            f"a gut of {anatomy.length_mm:.0f} mm is too short for blind ends of {anatomy.radius_mm:.0f} mm"
        )
    return anatomy.length_mm + caps * CAP_ROUND * anatomy.radius_mm


def arc_at(place: Array, anatomy: AnatomyConfig) -> Array:
    """Arc length (mm) at distances `place` (mm) along a smooth wall; the two differ on half-spherical ends."""
    radius, length = anatomy.radius_mm, anatomy.length_mm
    rest = unrolled_length(anatomy) - place
    arc = place - CAP_ROUND * radius if anatomy.closed_start else place
    if anatomy.closed_start:
        arc = np.where(place < np.pi / 2 * radius, radius * (1 - np.cos(place / radius)), arc)
    if anatomy.closed_end:
        arc = np.where(rest < np.pi / 2 * radius, length - radius * (1 - np.cos(rest / radius)), arc)
    return arc
