"""Centreline of a gut: a random curve with a rotation-minimizing frame (Bishop 1975)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from haustra.phantom.config import AnatomyConfig
from haustra.phantom.noise import path_noise

Array = NDArray[np.float64]
FLEXURE_MM = 28.0  # width of a flexure's curvature bump; it turns the lumen by a right angle within some 60 mm
LONG_AXIS = 0.4  # widening across of a lumen that is pressed flat: its wall keeps its length
STEP_MM = 0.5  # between samples; far below any radius of curvature (tens of mm)


@dataclass(frozen=True)
class Centreline:
    """Samples at every STEP_MM: arc length (S,) mm, points (S,3) mm, frames (S,3,3) with columns N1 N2 T."""

    arc: Array
    points: Array
    frames: Array

    def at(self, arc: Array) -> tuple[Array, Array]:
        """Points (...,3) and frames (...,3,3) at arc lengths (...), clamped to the ends."""
        place = np.clip(np.asarray(arc, float) / STEP_MM, 0, len(self.arc) - 1.001)
        low = place.astype(int)
        part = place - low
        points = self.points[low] + part[..., None] * (self.points[low + 1] - self.points[low])
        frames = self.frames[low] + part[..., None, None] * (self.frames[low + 1] - self.frames[low])
        return points, frames / np.linalg.norm(frames, axis=-2, keepdims=True)


def grow_centreline(anatomy: AnatomyConfig, rng: np.random.Generator) -> Centreline:
    """A random centreline whose tube does not intersect itself.

    The curvature bound keeps neighbouring cross-sections apart; for distant parts, the curvature is reduced until
    they are apart.
    """
    arc = np.arange(0.0, anatomy.length_mm + STEP_MM, STEP_MM)
    curvature = _random_curvature(arc, anatomy, rng)
    while True:
        line = _integrate(arc, curvature)
        if not _meets_itself(line, _widest(anatomy)):
            return line
        curvature *= 0.8


def _widest(anatomy: AnatomyConfig) -> float:
    """Bound on the lumen's radius, mm."""
    round_mm = anatomy.radius_mm * (1 + anatomy.radius_variation) + anatomy.sacculation_mm + 3 * anatomy.relief_mm
    return round_mm * (1 + LONG_AXIS * anatomy.collapse)


def _random_curvature(arc: Array, anatomy: AnatomyConfig, rng: np.random.Generator) -> Array:
    """Curvature about N2 and -N1 (S,2) in 1/mm: smooth noise plus the flexures."""
    limit = anatomy.bend / _widest(anatomy)
    period = 90.0 / STEP_MM  # gentle S-bends are about a decimetre long
    curvature = 0.5 * limit * np.stack([path_noise(len(arc), period, rng) for _ in range(2)], axis=1)
    for place in _flexure_places(anatomy, rng):
        heading = rng.uniform(0, 2 * np.pi)
        bump = limit * np.exp(-(((arc - place) / FLEXURE_MM) ** 2))
        curvature += bump[:, None] * np.array([np.cos(heading), np.sin(heading)])
    size = np.linalg.norm(curvature, axis=1, keepdims=True)
    return curvature * np.minimum(1.0, limit / np.maximum(size, 1e-9))


def _flexure_places(anatomy: AnatomyConfig, rng: np.random.Generator) -> list[float]:
    """Arc lengths (mm) of the flexures: two near the ends, where they hide the openings, the others anywhere."""
    ends = [rng.uniform(0.12, 0.2), 1 - rng.uniform(0.12, 0.2)]
    others = rng.uniform(0.25, 0.75, max(0, anatomy.flexures - 2))
    return [float(part) * anatomy.length_mm for part in [*ends, *others][: anatomy.flexures]]


def _integrate(arc: Array, curvature: Array) -> Centreline:
    """Centreline of curvature (S,2); the frame turns about axes in the cross-section only, hence no twist."""
    turns = np.stack([-curvature[:, 1], curvature[:, 0], np.zeros(len(arc))], axis=1) * STEP_MM
    steps = Rotation.from_rotvec(turns).as_matrix()
    frames = np.empty((len(arc), 3, 3))
    frames[0] = np.eye(3)
    for i in range(1, len(arc)):
        frames[i] = frames[i - 1] @ steps[i]
    tangents = frames[:, :, 2]
    middle = 0.5 * (tangents[1:] + tangents[:-1]) * STEP_MM
    return Centreline(arc, np.vstack([np.zeros(3), np.cumsum(middle, axis=0)]), frames)


def _meets_itself(line: Centreline, radius: float) -> bool:
    """True if parts further apart along the curve than a half turn come closer than two radii."""
    points = line.points[:: int(4 / STEP_MM)]
    arc = line.arc[:: int(4 / STEP_MM)]
    apart = np.linalg.norm(points[:, None] - points[None], axis=-1)
    distant = np.abs(arc[:, None] - arc[None]) > np.pi * radius
    return bool(np.any(apart[distant] < 2.2 * radius))
