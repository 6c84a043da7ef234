"""Blood vessels on the unrolled wall: a polygonal submucosal network and branching trees, as opacities in [0,1].

Both know the wall's shape: calibres and lengths are millimetres on the surface, wherever the sheet is squeezed
or stretched.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from haustra.phantom.noise import SolidNoise

Floats = NDArray[np.float32]
Array = NDArray[np.float64]
MARGIN = 96  # texels beside the sheet on which strokes are drawn before they are wrapped around
SHIFT = 4  # bits of cv2's fixed-point coordinates: 1/16 texel
STEP_MM = 0.7  # of a growing vessel
FORK = 0.11  # probability of a fork per step
EMERGE_STEPS = 12  # over which a trunk becomes opaque


def polygon_network(points: Floats, cell_mm: float, width_mm: float, rng: np.random.Generator) -> Floats:
    """Opacity (h,w) of warped Worley ridges (Worley 1996) at wall points (h,w,3).

    The boundaries of space-filling cells intersect the surface in polygons whose lines are wide where a boundary is
    oblique: a network of varying calibre, as under the colon's mucosa.
    """
    warp = [SolidNoise(2.5 * cell_mm, 0.3 * cell_mm, rng) for _ in range(3)]
    warped = points + 0.1 * cell_mm * np.stack([noise(points) for noise in warp], axis=-1)
    near, owners = _nearest_two(warped, cell_mm, rng)
    gap = near[..., 1] - near[..., 0]  # mm; twice the distance from the ridge where the wall cuts it squarely
    pair = np.sort(owners, axis=-1).astype(np.uint32)
    dice = (pair[..., 0] * np.uint32(2654435761) ^ pair[..., 1] * np.uint32(2246822519)) >> np.uint32(8)
    chance = (dice % 1024).astype(np.float32) / 1024  # one number per ridge
    half_width = width_mm * (0.35 + 0.9 * chance)
    return (0.3 + 0.7 * chance) / (1 + np.exp(np.minimum(6.0 * (gap / half_width - 1), 30.0)))


def _nearest_two(points: Floats, cell_mm: float, rng: np.random.Generator) -> tuple[Floats, NDArray[np.int64]]:
    """Distances (h,w,2) mm to the two nearest of random seeds about the wall, and the seeds' numbers (h,w,2)."""
    flat = points.reshape(-1, 3)
    crowd = int(12 * SheetScale(points).area_mm2 / cell_mm**2)  # enough candidates for dart throwing to cover the wall
    seeds = flat[rng.integers(len(flat), size=max(crowd, 8))].astype(float)
    seeds += rng.uniform(-0.5, 0.5, seeds.shape) * cell_mm
    chosen = _thin_out(seeds, 0.75 * cell_mm, rng)
    distance, index = cKDTree(chosen).query(flat, k=2)
    shape = (*points.shape[:2], 2)
    return distance.astype(np.float32).reshape(shape), index.reshape(shape)


def _thin_out(points: Array, spacing_mm: float, rng: np.random.Generator) -> Array:
    """A random subset in which no two points are closer than the spacing (dart throwing)."""
    points = points[rng.permutation(len(points))]
    neighbours = cKDTree(points).query_ball_point(points, spacing_mm)
    free = np.ones(len(points), bool)
    for index, around in enumerate(neighbours):
        if free[index]:
            free[around] = False
            free[index] = True
    return points[free]


class SheetScale:
    """Millimetres of wall per texel, along and around, at any place of the sheet."""

    def __init__(self, points: Floats) -> None:
        along = np.linalg.norm(np.gradient(points[::4, ::4], axis=0), axis=-1) / 4
        around = np.linalg.norm(np.gradient(points[::4, ::4], axis=1), axis=-1) / 4
        self._mm = np.maximum(np.stack([around, along], axis=-1), 1e-3)
        self.shape = points.shape[:2]

    @property
    def area_mm2(self) -> float:
        """Area of the whole wall."""
        return float(self._mm.prod(axis=-1).mean() * self.shape[0] * self.shape[1])

    def texel_mm2(self) -> Floats:
        """Area (rows, columns) of wall under every texel."""
        area = self._mm.prod(axis=-1).astype(np.float32)
        return cv2.resize(area, self.shape[::-1], interpolation=cv2.INTER_LINEAR)

    def __call__(self, texels: Array) -> Array:
        """(K,2) mm per texel around and along, at (K,2) texels (column, row)."""
        row = np.clip(texels[:, 1] / 4, 0, self._mm.shape[0] - 1).astype(int)
        return self._mm[row, (texels[:, 0] / 4).astype(int) % self._mm.shape[1]]


def vessel_trees(points: Floats, per_cm2: float, width_mm: float, rng: np.random.Generator) -> Floats:
    """Opacity (h,w) of branching vessels on wall points (h,w,3); calibre falls at every fork."""
    scale = SheetScale(points)
    segments, calibres, opacities = _grow(_scatter(scale, per_cm2, rng), width_mm, scale, rng)
    return _draw(segments, calibres, opacities, scale).astype(np.float32) / np.float32(255)


def _scatter(scale: SheetScale, per_cm2: float, rng: np.random.Generator) -> Array:
    """Random texels (K,2), uniform over the wall's area."""
    rows, columns = scale.shape
    texels = rng.uniform(0, 1, (2000, 2)) * (columns, rows)
    area = scale(texels).prod(axis=1)
    count = rng.poisson(per_cm2 * scale.area_mm2 / 100)
    return texels[rng.choice(len(texels), count, p=area / area.sum())]


def _grow(tips: Array, width_mm: float, scale: SheetScale, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Random walk of all tips until their calibre is below 0.07 mm.

    Returns segments (K,2,2) in texels, calibres (K,) mm and opacities (K,), which rise over a trunk's first steps.
    """
    segments, calibres, opacities = [np.empty((0, 2, 2))], [np.empty(0)], [np.empty(0)]
    heading, bend = rng.uniform(0, 2 * np.pi, len(tips)), np.zeros(len(tips))
    width = width_mm * rng.uniform(0.4, 1.0, len(tips))
    while len(tips):
        bend = 0.8 * bend + 0.07 * rng.standard_normal(len(tips))
        heading = heading + bend
        ahead = tips + STEP_MM * np.stack([np.cos(heading), np.sin(heading)], axis=1) / scale(tips)
        segments.append(np.stack([tips, ahead], axis=1))
        calibres.append(width)
        opacities.append(np.full(len(tips), min(1.0, len(segments) / EMERGE_STEPS)))
        fork = rng.uniform(size=len(tips)) < FORK
        side = heading[fork] + rng.choice([-1, 1], fork.sum()) * rng.uniform(0.4, 1.1, fork.sum())
        tips = np.concatenate([ahead, ahead[fork]])
        heading = np.concatenate([heading, side])
        width = np.concatenate([width * np.where(fork, 0.85, 0.985), 0.6 * width[fork]])
        bend = np.concatenate([bend, np.zeros(fork.sum())])
        alive = (width > 0.07) & (tips[:, 1] > 0) & (tips[:, 1] < scale.shape[0])
        tips, heading, width, bend = tips[alive], heading[alive], width[alive], bend[alive]
    return np.concatenate(segments), np.concatenate(calibres), np.concatenate(opacities)


def _draw(segments: Array, widths_mm: Array, opacities: Array, scale: SheetScale) -> NDArray[np.uint8]:
    """Ink (rows, columns) 0..255 of segments on a sheet that wraps in its columns; below a texel's width fainter."""
    rows, columns = scale.shape
    ink = np.zeros((rows, columns + 2 * MARGIN), np.uint8)
    middle = segments.mean(axis=1)
    widths = widths_mm / np.sqrt(scale(middle).prod(axis=1))
    shifted = segments.copy()
    shifted[..., 0] += MARGIN - columns * np.floor(middle[:, :1] / columns)
    strokes = np.round(shifted * (1 << SHIFT)).astype(np.int32)
    levels = np.ceil(16 * opacities * np.minimum(1.0, widths)).astype(int) * 255 // 16
    calibres = np.maximum(1, np.round(widths)).astype(int)
    for level, calibre in np.unique(np.stack([levels, calibres], axis=1), axis=0):
        chosen = strokes[(levels == level) & (calibres == calibre)]
        cv2.polylines(ink, list(chosen), False, int(level), int(calibre), cv2.LINE_AA, SHIFT)
    sheet = ink[:, MARGIN : MARGIN + columns].copy()
    sheet[:, :MARGIN] = np.maximum(sheet[:, :MARGIN], ink[:, MARGIN + columns :])
    sheet[:, -MARGIN:] = np.maximum(sheet[:, -MARGIN:], ink[:, :MARGIN])
    return sheet
