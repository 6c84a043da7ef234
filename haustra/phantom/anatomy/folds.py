"""Haustral folds and plicae: crescents that reach into the lumen, lean, tilt and occlude the wall behind them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from haustra.phantom.config import AnatomyConfig

Array = NDArray[np.float64]
MIN_GAP = 0.2  # distance between two points of equal radius after leaning over that before; 0 lets folds touch
STRAIGHTEN = 0.8  # factor on the lean of a fold too near its neighbour, applied until it is not
LEVELS = 40  # heights at which gaps are measured: half a millimetre to a millimetre apart


@dataclass(frozen=True)
class Fold:
    """One crescent. Its rim runs at arc + tilt * cos(angle - tilt_phase)."""

    arc_mm: float
    angle_rad: float  # middle of the crescent
    half_span_rad: float  # half the angle it covers; pi and more closes the ring
    depth_mm: float
    width_mm: float  # decay length of the flanks
    tilt_mm: float
    tilt_phase_rad: float
    lean: float  # axial shift of the rim per depth


def place_folds(anatomy: AnatomyConfig, rng: np.random.Generator) -> list[Fold]:
    """Folds of a gut: stations along it, each with its crescents."""
    folds: list[Fold] = []
    arc = rng.uniform(0.2, 1.0) * anatomy.fold_spacing_mm
    while arc < anatomy.length_mm - 4:
        folds += _station(arc, anatomy, rng)
        arc += anatomy.fold_spacing_mm * (1 + anatomy.fold_spacing_jitter * rng.uniform(-1, 1))
    return folds


def _station(arc: float, anatomy: AnatomyConfig, rng: np.random.Generator) -> list[Fold]:
    """In the colon two or three crescents, one per gap between taeniae; in the small intestine one ring."""
    if anatomy.scene == "small_intestine":
        return [_fold(arc, rng.uniform(0, 2 * np.pi), rng.uniform(2.2, 5.0), anatomy, rng)]
    twist = np.radians(anatomy.taenia_twist_deg_per_mm) * arc
    gaps = rng.permutation(3)[: rng.choice([1, 2, 3], p=[0.15, 0.4, 0.45])]
    middles = twist + np.pi / 3 + gaps * 2 * np.pi / 3
    stagger = 0.12 * anatomy.fold_spacing_mm
    return [
        _fold(arc + rng.normal(0, stagger), middle + rng.normal(0, 0.2), rng.uniform(0.9, 1.7), anatomy, rng)
        for middle in middles
    ]


def _fold(arc: float, angle: float, half_span: float, anatomy: AnatomyConfig, rng: np.random.Generator) -> Fold:
    """One crescent at arc (mm) and angle (rad) with random depth, width, tilt and lean."""
    depth = anatomy.fold_depth_mm * max(0.15, 1 + anatomy.fold_depth_jitter * rng.normal())
    return Fold(
        arc_mm=float(arc),
        angle_rad=float(angle),
        half_span_rad=float(half_span),
        depth_mm=float(min(depth, 0.6 * anatomy.radius_mm)),
        width_mm=float(anatomy.fold_width_mm * rng.uniform(0.7, 1.4)),
        tilt_mm=float(anatomy.fold_tilt_mm * rng.normal()),
        tilt_phase_rad=float(rng.uniform(0, 2 * np.pi)),
        lean=float(anatomy.fold_lean * rng.uniform(-1, 1)),
    )


def fold_relief(folds: list[Fold], arc: Array, angle: Array, anatomy: AnatomyConfig) -> tuple[Array, Array]:
    """Height into the lumen and shift along it (mm) at broadcast arc (mm) and angle (rad), both two-dimensional."""
    shape = np.broadcast_shapes(arc.shape, angle.shape)
    power, shift, bulge = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for fold in folds:
        reached = np.abs(arc - fold.arc_mm) < _reach(fold)
        near = np.flatnonzero(reached.any(axis=1))
        if len(near) == 0:
            continue
        part = slice(near[0], near[-1] + 1)  # far rows are skipped
        height, nearness = _one_fold(fold, arc[part], angle[part] if len(angle) > 1 else angle, anatomy)
        power[part] += height**4  # a soft maximum lets crescents merge instead of adding up
        shift[part] += fold.lean * height
        bulge[part] += nearness
    return power**0.25 - anatomy.sacculation_mm * (0.5 - np.minimum(bulge, 1.0)), shift


def _reach(fold: Fold) -> float:
    """Distance (mm) along the gut beyond which a fold's height is negligible."""
    return abs(fold.tilt_mm) + 9 * fold.width_mm


def _one_fold(fold: Fold, arc: Array, angle: Array, anatomy: AnatomyConfig) -> tuple[Array, Array]:
    """Height (mm) of a single crescent, and nearness of its rim (0 to 1), where the wall does not bulge out."""
    edge, reach = anatomy.fold_edge_mm, 0.3 * anatomy.fold_spacing_mm
    away = np.angle(np.exp(1j * (angle - fold.angle_rad)))
    window = (0.5 + 0.5 * np.cos(np.pi * np.clip(away / fold.half_span_rad, -1, 1))) ** 0.6
    offset = arc - fold.arc_mm - fold.tilt_mm * np.cos(angle - fold.tilt_phase_rad)
    flank = np.exp(-(np.hypot(offset, edge) - edge) / fold.width_mm)  # |offset| with a rounded rim
    return fold.depth_mm * window * flank, window * np.exp(-((offset / reach) ** 2))


@dataclass(frozen=True)
class Gaps:
    """Pairs (K,) of consecutive wall points of equal radius at one angle, and the distance that leaning leaves them."""

    before_mm: Array  # arc length
    behind_mm: Array
    column: NDArray[np.int_]  # index of the angle
    left: Array  # distance along the lumen per distance in arc length; at 0 the wall meets itself

    def narrow(self) -> Gaps:
        """The gaps below MIN_GAP by more than rounding."""
        short = (MIN_GAP - self.left) * (self.behind_mm - self.before_mm) > 1e-6
        return Gaps(self.before_mm[short], self.behind_mm[short], self.column[short], self.left[short])


def measure_gaps(arc: Array, along: Array, radius: Array) -> Gaps:
    """Gaps between wall points at LEVELS radii; arc (M,) mm, along and radius (M,N) mm.

    In the half plane of one angle the wall is the curve (along, radius). Where equal radii follow each other along the
    lumen as they do in arc length, no two of its points can coincide, however far it overhangs.
    """
    parts = [_between(*_crossings(arc, along, radius, level)) for level in _levels(radius)]
    before, behind, columns, lefts = zip(*parts, _turns(arc, along, radius))
    return Gaps(*(np.concatenate(part) for part in (before, behind, columns, lefts)))


def _levels(radius: Array) -> Array:
    """Radii (LEVELS,) mm between the least and the greatest."""
    return np.linspace(radius.min(), radius.max(), LEVELS + 2)[1:-1]


def _crossings(arc: Array, along: Array, radius: Array, level: float) -> tuple[Array, Array, NDArray[np.int_]]:
    """Arc length (K,), place along the lumen (K,) and column (K,) where the radius passes a level; by column, arc."""
    above = (radius > level).T
    column, row = np.nonzero(above[:, 1:] != above[:, :-1])
    part = (level - radius[row, column]) / (radius[row + 1, column] - radius[row, column])
    there = along[row, column] + part * (along[row + 1, column] - along[row, column])
    return arc[row] + part * (arc[row + 1] - arc[row]), there, column


def _turns(arc: Array, along: Array, radius: Array) -> tuple[Array, Array, NDArray[np.int_], Array]:
    """The columns of `Gaps` for rims, bottoms and plateaus, which lie between the levels."""
    slope = np.diff(radius, axis=0)
    row, column = np.nonzero(slope[1:] * slope[:-1] < 1e-9)
    left = (along[row + 2, column] - along[row, column]) / (arc[row + 2] - arc[row])
    return arc[row], arc[row + 2], column, left


def _between(arc: Array, along: Array, column: NDArray[np.int_]) -> tuple[Array, Array, NDArray[np.int_], Array]:
    """The columns of `Gaps` for successive crossings of one level."""
    pair = np.flatnonzero((column[1:] == column[:-1]) & (np.diff(arc) > 0))
    return arc[pair], arc[pair + 1], column[pair], np.diff(along)[pair] / np.diff(arc)[pair]


def straightened(
    folds: list[Fold], before: Array, behind: Array, weights: tuple[Array, Array], angle: Array, anatomy: AnatomyConfig
) -> list[Fold]:
    """The folds, with less lean for those that close the gaps between arcs `before` and `behind` (K,) mm most.

    `weights` (K,) is the part of its shift that the wall takes there, `angle` (K,) is in rad.
    """
    ends = list(zip((before, behind), weights))
    shifts = [
        fold.lean * np.array([weight * _height_near(fold, arc, angle, anatomy) for arc, weight in ends])
        for fold in folds
    ]
    closing = np.array([ahead - further for ahead, further in shifts])
    blamed = set(closing.argmax(axis=0).tolist())
    return [replace(fold, lean=fold.lean * STRAIGHTEN) if i in blamed else fold for i, fold in enumerate(folds)]


def _height_near(fold: Fold, arc: Array, angle: Array, anatomy: AnatomyConfig) -> Array:
    """Height (K,) mm of one crescent at arcs (K,) mm and angles (K,) rad; computed only within its reach."""
    height, near = np.zeros(len(arc)), np.abs(arc - fold.arc_mm) < _reach(fold)
    height[near] = _one_fold(fold, arc[near], angle[near], anatomy)[0]
    return height
