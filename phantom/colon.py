"""Anatomy to mesh: the wall as a radius over (arc length, angle), wrapped around a centreline.

Rows of the grid run along the gut, columns around it. Rows are spaced by wall length, not by arc length, so
that steep flanks of folds get as many vertices (and texels) per millimetre as the flat wall.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from phantom.centreline import Centreline, grow_centreline
from phantom.config import AnatomyConfig
from phantom.folds import Fold, fold_relief, place_folds
from phantom.noise import SolidNoise, path_noise

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
END_OPENING = 0.04  # of the radius that stays open at the ends


@dataclass(frozen=True)
class Polyp:
    """A sessile polyp: where it sits, in the sheet and in space, and how big it is."""

    arc_mm: float
    angle_rad: float
    radius_mm: float
    height_mm: float
    apex: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Colon:
    """A gut as a closed band of quads. M rows along, N columns around; column N is column 0 again."""

    anatomy: AnatomyConfig
    line: Centreline
    arc: Array  # (M,) arc length of each row, mm
    points: Floats  # (M,N,3) mm
    normals: Floats  # (M,N,3) unit, into the lumen
    polyp_cover: Floats  # (M,N) 0 on plain wall, 1 on a polyp
    spacing_mm: tuple[float, float]  # typical edge along and around
    polyps: list[Polyp]

    @property
    def vertices(self) -> Floats:
        """(M*N,3) mm."""
        return self.points.reshape(-1, 3)

    @cached_property
    def triangles(self) -> NDArray[np.int32]:
        """(2*(M-1)*N,3), normals into the lumen; two per cell in row-major order, as `grid_position` expects."""
        rows, columns = self.points.shape[:2]
        here = np.arange((rows - 1) * columns, dtype=np.int32).reshape(rows - 1, columns)
        right = np.roll(here, -1, axis=1)
        below, corner = here + columns, right + columns
        lower = np.stack([here, below, right], axis=-1)
        upper = np.stack([corner, right, below], axis=-1)
        return np.stack([lower, upper], axis=2).reshape(-1, 3)

    def grid_position(self, triangle: NDArray[np.uint32], bary: Floats) -> tuple[Floats, Floats]:
        """Fractional (row, column) of surface points: the sheet's coordinates, with no seam to cross."""
        cell, upper = np.divmod(triangle.astype(np.int32), 2)
        row, column = np.divmod(cell, self.points.shape[1])
        along = np.where(upper, 1 - bary[..., 0], bary[..., 0])
        around = np.where(upper, 1 - bary[..., 1], bary[..., 1])
        return (row + along).astype(np.float32), (column + around).astype(np.float32)


def build_colon(anatomy: AnatomyConfig, seed: int) -> Colon:
    """Grow one gut. The seed fixes it together with the config."""
    rng = np.random.default_rng([seed, 1])
    line = grow_centreline(anatomy, rng)
    wall = _Wall(anatomy, place_folds(anatomy, rng), _place_polyps(anatomy, rng), rng)
    arc = _space_rows(wall, anatomy)
    columns = max(24, round(2 * np.pi * anatomy.radius_mm / anatomy.edge_mm))
    angle = np.arange(columns) * 2 * np.pi / columns
    radius, shift, cover = wall.evaluate(arc[:, None], angle[None, :])
    smooth = _wrap(line, arc[:, None] + shift, angle, radius)
    radius = radius * (1 + _relief(smooth, anatomy, rng) / anatomy.radius_mm)
    points = _wrap(line, arc[:, None] + shift, angle, radius)
    spacing = (anatomy.edge_mm, 2 * np.pi * anatomy.radius_mm / columns)
    polyps = [_with_apex(polyp, arc, angle, points) for polyp in wall.polyps]
    floats = points.astype(np.float32)
    return Colon(anatomy, line, arc, floats, _normals(points), cover.astype(np.float32), spacing, polyps)


class _Wall:
    """Radius, axial shift and polyp cover as functions of arc length (mm) and angle (rad)."""

    def __init__(
        self, anatomy: AnatomyConfig, folds: list[Fold], polyps: list[Polyp], rng: np.random.Generator
    ) -> None:
        self.anatomy, self.folds, self.polyps = anatomy, folds, polyps
        self._knots = np.arange(0.0, anatomy.length_mm + 2.0)
        self._widening = 1 + anatomy.radius_variation * path_noise(len(self._knots), 80.0, rng)

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
            around = np.angle(np.exp(1j * (angle - polyp.angle_rad))) * anatomy.radius_mm
            distance = np.hypot(arc - polyp.arc_mm, around) / polyp.radius_mm
            bump = np.exp(-(distance**4))  # flat top, steep side
            radius, cover = radius - polyp.height_mm * bump, np.maximum(cover, bump)
        return radius * _pinch(arc, anatomy), shift, cover


def _pinch(arc: Array, anatomy: AnatomyConfig) -> Array:
    """Factor that narrows the lumen towards both ends, as a contraction does: little is seen through them."""
    part = np.clip(np.minimum(arc, anatomy.length_mm - arc) / anatomy.pinch_mm, 0, 1)
    return END_OPENING + (1 - END_OPENING) * np.sin(0.5 * np.pi * part)


def _place_polyps(anatomy: AnatomyConfig, rng: np.random.Generator) -> list[Polyp]:
    margin = min(30.0, 0.2 * anatomy.length_mm)
    arcs = rng.uniform(margin, anatomy.length_mm - margin, anatomy.polyps)
    sizes = anatomy.polyp_radius_mm * rng.uniform(0.6, 1.5, anatomy.polyps)
    angles, flatness = rng.uniform(0, 2 * np.pi, anatomy.polyps), rng.uniform(0.5, 1.0, anatomy.polyps)
    return [Polyp(float(a), float(t), float(r), float(r * f)) for a, t, r, f in zip(arcs, angles, sizes, flatness)]


def _space_rows(wall: _Wall, anatomy: AnatomyConfig) -> Array:
    """Arc lengths whose steps are one mesh edge of wall at the steepest angle."""
    arc = np.arange(0.0, anatomy.length_mm, 0.25)
    radius, shift, _ = wall.evaluate(arc[:, None], np.linspace(0, 2 * np.pi, 60, endpoint=False)[None, :])
    along, inward = np.gradient(arc[:, None] + shift, 0.25, axis=0), np.gradient(radius, 0.25, axis=0)
    speed = np.hypot(along, inward).max(axis=1)
    length = np.concatenate([[0.0], np.cumsum(0.125 * (speed[1:] + speed[:-1]))])
    return np.interp(np.linspace(0, length[-1], max(8, round(length[-1] / anatomy.edge_mm))), length, arc)


def _relief(points: Array, anatomy: AnatomyConfig, rng: np.random.Generator) -> Floats:
    """Undulation of the wall (M,N) mm at three scales; smaller scales are shallower."""
    bands = [(40.0, 9.0, 1.0), (9.0, 4.0, 0.16), (4.0, 2.0, 0.04)]
    floats = points.astype(np.float32)
    layers = [amplitude * SolidNoise(big, small, rng)(floats) for big, small, amplitude in bands]
    return anatomy.relief_mm * np.sum(layers, axis=0)


def _wrap(line: Centreline, arc: Array, angle: Array, radius: Array) -> Array:
    """Cylinder coordinates around the centreline to points (M,N,3)."""
    centre, frame = line.at(np.clip(arc, 0, line.arc[-1]))
    outward = np.cos(angle)[:, None] * frame[..., 0] + np.sin(angle)[:, None] * frame[..., 1]
    beyond = arc - np.clip(arc, 0, line.arc[-1])  # leaning folds at an open end keep their shape
    return centre + radius[..., None] * outward + beyond[..., None] * frame[..., 2]


def _normals(points: Array) -> Floats:
    along = np.gradient(points, axis=0)
    around = np.roll(points, -1, axis=1) - np.roll(points, 1, axis=1)
    normal = np.cross(along, around)
    return (normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)).astype(np.float32)


def _with_apex(polyp: Polyp, arc: Array, angle: Array, points: Array) -> Polyp:
    row = int(np.argmin(np.abs(arc - polyp.arc_mm)))
    column = int(np.argmin(np.abs(np.angle(np.exp(1j * (angle - polyp.angle_rad))))))
    x, y, z = (float(v) for v in points[row, column])
    return Polyp(polyp.arc_mm, polyp.angle_rad, polyp.radius_mm, polyp.height_mm, (x, y, z))
