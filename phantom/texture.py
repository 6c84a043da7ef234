"""The painted wall: reflectance and bumped normals on the unrolled sheet, far finer than the mesh.

The sheet is computed once per colon and sampled per pixel at the hit point, so detail sticks to the surface.
A small pyramid (mip maps, Williams 1983) keeps distant wall from aliasing into noise that no tracker could follow.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from phantom.colon import Colon
from phantom.config import AppearanceConfig
from phantom.noise import SolidNoise
from phantom.vessels import MARGIN, polygon_network, vessel_trees

Floats = NDArray[np.float32]
LEVELS = 4  # 1, 2, 4, 8 texels: 0.13 to 1 mm, the footprint of a pixel at 150 mm


class SurfaceTexture:
    """Reflectance (linear RGB) and unit normals of a colon's wall, by fractional grid row and column."""

    def __init__(self, colon: Colon, appearance: AppearanceConfig, seed: int) -> None:
        rng = np.random.default_rng([seed, 2])
        self.texel_mm = appearance.texel_mm
        self._grid = colon.points.shape[:2]
        shape = _sheet_shape(colon, appearance.texel_mm)
        points = _on_sheet(colon.points, shape)
        cover = _on_sheet(colon.polyp_cover, shape)
        vessels = _vessel_opacity(points, cover, appearance, rng)
        albedo = _paint(points, cover, vessels, appearance, rng)
        albedo *= _cavity_shade(colon, shape, appearance.cavity)[..., None]
        self._albedo = _pyramid(np.clip(albedo, 0.0, 1.0))
        self._normals = _pyramid(_bumped_normals(colon, points, appearance, rng))

    def sample(self, row: Floats, column: Floats, footprint_mm: Floats) -> tuple[Floats, Floats]:
        """Reflectance and normal (H,W,3) at grid coordinates (H,W); `footprint_mm` is a pixel's size there."""
        level = np.clip(np.log2(np.maximum(footprint_mm / self.texel_mm, 1e-6)), 0, LEVELS - 1)
        albedo, normal = np.zeros((*row.shape, 3), np.float32), np.zeros((*row.shape, 3), np.float32)
        for index in range(LEVELS):
            weight = np.maximum(0.0, 1.0 - np.abs(level - index)).astype(np.float32)
            if not weight.any():
                continue
            x, y = self._texel(row, column, index)
            albedo += weight[..., None] * cv2.remap(self._albedo[index], x, y, cv2.INTER_LINEAR)
            normal += weight[..., None] * cv2.remap(self._normals[index], x, y, cv2.INTER_LINEAR)
        return albedo, normal / np.maximum(np.sqrt(np.einsum("hwc,hwc->hw", normal, normal)), 1e-6)[..., None]

    def _texel(self, row: Floats, column: Floats, level: int) -> tuple[Floats, Floats]:
        """Positions in a pyramid level; texel centres are at half integers and one wrapped texel comes first."""
        height, width = self._albedo[level].shape[:2]
        x = column * ((width - 2) / self._grid[1]) + 0.5
        y = row * (height / (self._grid[0] - 1)) - 0.5
        return x.astype(np.float32), np.clip(y, 0, height - 1).astype(np.float32)


def _sheet_shape(colon: Colon, texel_mm: float) -> tuple[int, int]:
    """Rows and columns of the finest level, multiples of the coarsest level's texel."""
    block = 2 ** (LEVELS - 1)
    edges = (colon.points.shape[0] - 1, colon.points.shape[1])
    rows, columns = (round(n * s / texel_mm / block) * block for n, s in zip(edges, colon.spacing_mm))
    return max(rows, block), max(columns, 2 * MARGIN)  # strokes need some width to wrap around


def _on_sheet(grid: Floats, shape: tuple[int, int]) -> Floats:
    """Values on the mesh's vertices (M,N,...) interpolated to texel centres."""
    closed = np.concatenate([grid, grid[:, :1]], axis=1)  # column N is column 0
    rows = (np.arange(shape[0], dtype=np.float32) + 0.5) * (grid.shape[0] - 1) / shape[0]
    columns = (np.arange(shape[1], dtype=np.float32) + 0.5) * grid.shape[1] / shape[1]
    x, y = np.meshgrid(columns, rows)
    return cv2.remap(np.ascontiguousarray(closed), x, y, cv2.INTER_LINEAR)


def _pyramid(sheet: Floats) -> list[Floats]:
    """Halved sheets, each padded with one wrapped column on both sides."""
    levels = [sheet]
    for _ in range(LEVELS - 1):
        height, width = levels[-1].shape[:2]
        levels.append(cv2.resize(levels[-1], (width // 2, height // 2), interpolation=cv2.INTER_AREA))
    return [cv2.copyMakeBorder(level, 0, 0, 1, 1, cv2.BORDER_WRAP) for level in levels]


def _coarsely(noise: SolidNoise, points: Floats, step: int) -> Floats:
    """A smooth field at every `step`-th texel, interpolated in between: looking noise up is the slow part."""
    coarse = noise(points[step // 2 :: step, step // 2 :: step])
    return cv2.resize(coarse, (points.shape[1], points.shape[0]), interpolation=cv2.INTER_LINEAR)


def _vessel_opacity(points: Floats, cover: Floats, appearance: AppearanceConfig, rng: np.random.Generator) -> Floats:
    """Both kinds of vessels as one opacity (rows, columns) in [0,1]; polyps hide the deep network."""
    opacity = np.zeros(cover.shape, np.float32)
    if appearance.mesh_vessels:
        deep = polygon_network(points[::2, ::2], appearance.mesh_cell_mm, appearance.mesh_width_mm, rng)
        deep = cv2.resize(deep, cover.shape[::-1], interpolation=cv2.INTER_LINEAR)
        spread = _coarsely(SolidNoise(60.0, 15.0, rng), points, 8)  # the vascular pattern comes and goes
        opacity = appearance.mesh_vessels * deep * np.clip(0.65 + 0.35 * spread, 0, 1) * (1 - 0.8 * cover)
    if appearance.tree_vessels and appearance.trees_per_cm2:
        trees = vessel_trees(points, appearance.trees_per_cm2, appearance.tree_width_mm, rng)
        opacity = np.maximum(opacity, appearance.tree_vessels * trees * (1 - 0.3 * cover))
    return opacity


def _paint(
    points: Floats, cover: Floats, vessels: Floats, appearance: AppearanceConfig, rng: np.random.Generator
) -> Floats:
    """Reflectance (rows, columns, 3) from base colours, mottling, red patches, vessels and polyps."""
    drift = _coarsely(SolidNoise(3 * appearance.blotch_mm, 0.4 * appearance.blotch_mm, rng), points, 8)
    drift = 1 / (1 + np.exp(-1.5 * drift))
    patches = _coarsely(SolidNoise(20.0, 3.0, rng), points, 4)
    red = np.clip(patches - 0.7, 0, 1) * appearance.erythema + 0.35 * cover
    mottle = appearance.mottle * _coarsely(SolidNoise(8.0, 1.2, rng), points, 2)
    mottle += appearance.grain * SolidNoise(1.5, 0.25, rng)(points)
    sheet = np.empty((*cover.shape, 3), np.float32)
    for channel, (redness, response) in enumerate([(0.08, 0.6), (0.75, 1.0), (0.65, 1.0)]):
        tissue, other = appearance.tissue[channel], appearance.tissue_other[channel]
        base = (tissue + (other - tissue) * drift) * (1 - redness * red) * np.exp(response * mottle)
        sheet[..., channel] = base * (1 - vessels * (1 - appearance.vessel_colour[channel]))
    return sheet


def _cavity_shade(colon: Colon, shape: tuple[int, int], strength: float) -> Floats:
    """Factor near 1: darker where the wall lies behind its neighbourhood, brighter where it stands out."""
    wide = np.concatenate([colon.points[:, -12:], colon.points, colon.points[:, :12]], axis=1)
    behind = cv2.GaussianBlur(wide, (0, 0), 4.0, borderType=cv2.BORDER_REFLECT_101)[:, 12:-12] - colon.points
    depth_mm = np.einsum("mnc,mnc->mn", behind, colon.normals)
    return _on_sheet(1 - strength * np.tanh(depth_mm / 1.5), shape)


def _bumped_normals(colon: Colon, points: Floats, appearance: AppearanceConfig, rng: np.random.Generator) -> Floats:
    """Smooth mesh normals tilted by the gradient of a fine height field (Blinn 1978), (rows, columns, 3)."""
    normals = _on_sheet(colon.normals, points.shape[:2])
    if not appearance.bump_mm:
        return normals / np.linalg.norm(normals, axis=-1, keepdims=True)
    height = appearance.bump_mm * SolidNoise(4.0, 0.35, rng, slope=0.8)(points)
    for axis in (0, 1):
        tangent = np.gradient(points, axis=axis)  # mm per texel
        squared = np.maximum(np.einsum("hwc,hwc->hw", tangent, tangent), (0.2 * appearance.texel_mm) ** 2)
        normals -= (np.gradient(height, axis=axis) / squared)[..., None] * tangent
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)
