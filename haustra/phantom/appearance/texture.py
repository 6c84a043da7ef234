"""Surface texture: reflectance, gloss and bump-mapped normals on the unrolled sheet, far finer than the mesh.

The sheet is computed once per colon and sampled per pixel at the hit point, so that detail is fixed to the surface.
Mip maps (Williams 1983) keep distant wall from aliasing into noise that no tracker could follow.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.phantom.anatomy.colon import Colon
from haustra.phantom.appearance.coating import Coating, coat
from haustra.phantom.appearance.vessels import MARGIN, polygon_network, vessel_trees
from haustra.phantom.config import AppearanceConfig
from haustra.phantom.noise import SolidNoise

Floats = NDArray[np.float32]
VILLI_MM = (3.0, 0.4)  # longest and shortest wavelength of villi; most of their power lies at 0.4 to 1 mm
VILLI_SHADE = 0.12  # relative standard deviation of reflectance by villi 0.3 mm high: bright tips, dark clefts
LEVELS = 4  # of the mip map: 1, 2, 4, 8 texels, 0.13 to 1 mm; the last is a pixel's footprint at 150 mm


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
        smooth = _on_sheet(colon.normals, shape)
        coating = coat(points, smooth, appearance, seed) if appearance.stool or appearance.fluid else None
        velvet = _velvet(colon.anatomy.villi_mm, points, seed)
        if velvet is not None:
            albedo *= np.exp(VILLI_SHADE / 0.3 * velvet)[..., None]
        gloss = np.ones(shape, np.float32)
        if coating:
            albedo = coating.paint(albedo, appearance, points, np.random.default_rng([seed, 5, 1]))
            gloss = coating.gloss()
        height = _relief(points, appearance, velvet, coating, rng)
        normals = _tilted(smooth, points, height, appearance.texel_mm)
        # Four channels, because cv2.remap is twice as fast on them as on three: gloss is free, normals are padded.
        self._paint = _pyramid(np.clip(albedo, 0.0, 1.0), gloss)
        self._slant = _pyramid(normals, np.zeros(shape, np.float32))

    def sample(self, row: Floats, column: Floats, footprint_mm: Floats) -> tuple[Floats, Floats, Floats]:
        """Reflectance (H,W,3), gloss (H,W), normal (H,W,3) at grid coordinates; `footprint_mm` is a pixel's size."""
        level = np.clip(np.log2(np.maximum(footprint_mm / self.texel_mm, 1e-6)), 0, LEVELS - 1)
        paint, slant = (np.zeros((*row.shape, 4), np.float32) for _ in range(2))
        for index in range(LEVELS):
            weight = np.maximum(np.float32(0), 1 - np.abs(level - np.float32(index)))
            box = _box(weight > 0)
            if not weight[box].size:
                continue
            x, y = self._texel(row[box], column[box], index)
            four = cv2.merge([weight[box]] * 4)
            for total, sheet in ((paint, self._paint[index]), (slant, self._slant[index])):
                part = cv2.remap(sheet, x, y, cv2.INTER_LINEAR)
                part *= four
                total[box] += part
        across, along, out, _ = cv2.split(slant)
        length = np.sqrt(across * across + along * along + out * out)
        return paint[..., :3], paint[..., 3], slant[..., :3] / np.maximum(length, 1e-6)[..., None]

    def _texel(self, row: Floats, column: Floats, level: int) -> tuple[Floats, Floats]:
        """Positions in a pyramid level; texel centres are at half integers and one wrapped texel comes first."""
        height, width = self._paint[level].shape[:2]
        x = column * ((width - 2) / self._grid[1]) + 0.5
        y = row * (height / (self._grid[0] - 1)) - 0.5
        return x.astype(np.float32), np.clip(y, 0, height - 1).astype(np.float32)


PATCH_EDGE = 8.0  # steepness of the border between pale and dark patches
PALEST = 0.95  # reflectance


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


def _pyramid(*layers: Floats) -> list[Floats]:
    """Halved sheets of all layers' channels, each padded with one wrapped column on both sides."""
    levels = []
    for index in range(LEVELS):
        if index:
            size = layers[0].shape[1] // 2, layers[0].shape[0] // 2
            layers = tuple(cv2.resize(layer, size, interpolation=cv2.INTER_AREA) for layer in layers)
        levels.append(cv2.copyMakeBorder(np.dstack(layers), 0, 0, 1, 1, cv2.BORDER_WRAP))
    return levels


def _box(needed: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Bounding box of what is True (H,W)."""
    left, top, width, height = cv2.boundingRect(needed.view(np.uint8))
    return slice(top, top + height), slice(left, left + width)


def _vessel_opacity(points: Floats, cover: Floats, appearance: AppearanceConfig, rng: np.random.Generator) -> Floats:
    """Opacity (rows, columns) in [0,1] of network and trees together; polyps hide the network."""
    opacity = np.zeros(cover.shape, np.float32)
    if appearance.mesh_vessels:
        deep = polygon_network(points[::2, ::2], appearance.mesh_cell_mm, appearance.mesh_width_mm, rng)
        deep = cv2.resize(deep, cover.shape[::-1], interpolation=cv2.INTER_LINEAR)
        spread = SolidNoise(60.0, 15.0, rng).coarsely(points, 8)  # the vascular pattern comes and goes
        opacity = appearance.mesh_vessels * deep * np.clip(0.65 + 0.35 * spread, 0, 1) * (1 - 0.8 * cover)
    if appearance.tree_vessels and appearance.trees_per_cm2:
        trees = vessel_trees(points, appearance.trees_per_cm2, appearance.tree_width_mm, rng)
        opacity = np.maximum(opacity, appearance.tree_vessels * trees * (1 - 0.3 * cover))
    return opacity


def _paint(
    points: Floats, cover: Floats, vessels: Floats, appearance: AppearanceConfig, rng: np.random.Generator
) -> Floats:
    """Reflectance (rows, columns, 3) from base colours, mottling, red patches, vessels and polyps."""
    drift = SolidNoise(3 * appearance.blotch_mm, 0.4 * appearance.blotch_mm, rng).coarsely(points, 8)
    drift = 1 / (1 + np.exp(-1.5 * drift))
    patches = SolidNoise(20.0, 3.0, rng).coarsely(points, 4)
    red = np.clip(patches - 0.7, 0, 1) * appearance.erythema + 0.35 * cover
    mottle = appearance.mottle * SolidNoise(8.0, 1.2, rng).coarsely(points, 2)
    mottle += appearance.grain * SolidNoise(1.5, 0.25, rng)(points)
    sheet = np.empty((*cover.shape, 3), np.float32)
    for channel, (redness, response) in enumerate([(0.08, 0.6), (0.75, 1.0), (0.65, 1.0)]):
        tissue, other = appearance.tissue[channel], appearance.tissue_other[channel]
        base = (tissue + (other - tissue) * drift) * (1 - redness * red) * np.exp(response * mottle)
        sheet[..., channel] = base * (1 - vessels * (1 - appearance.vessel_colour[channel]))
    if appearance.contrast > 1:  # drawn last, so that other walls keep their numbers
        patches = SolidNoise(3 * appearance.blotch_mm, appearance.blotch_mm, rng).coarsely(points, 8)
        pale = 1 / (1 + np.exp(-PATCH_EDGE * patches))
        sheet = np.minimum(sheet * appearance.contrast ** (pale - 0.5)[..., None], PALEST).astype(np.float32)
    return sheet


def _cavity_shade(colon: Colon, shape: tuple[int, int], strength: float) -> Floats:
    """Factor (rows, columns) near 1 on reflectance: less in concave, more in convex places of the wall."""
    wide = np.concatenate([colon.points[:, -12:], colon.points, colon.points[:, :12]], axis=1)
    behind = cv2.GaussianBlur(wide, (0, 0), 4.0, borderType=cv2.BORDER_REFLECT_101)[:, 12:-12] - colon.points
    depth_mm = np.einsum("mnc,mnc->mn", behind, colon.normals)
    return _on_sheet(1 - strength * np.tanh(depth_mm / 1.5), shape)


def _velvet(villi_mm: float, points: Floats, seed: int) -> Floats | None:
    """Height (rows, columns) mm of villi about its mean; `villi_mm` is four standard deviations. None without villi."""
    if not villi_mm:
        return None
    return 0.25 * villi_mm * SolidNoise(*VILLI_MM, np.random.default_rng([seed, 8]), slope=-1.0)(points)


def _relief(
    points: Floats,
    appearance: AppearanceConfig,
    velvet: Floats | None,
    coating: Coating | None,
    rng: np.random.Generator,
) -> Floats | None:
    """Relief (rows, columns) mm too fine for the mesh: less under fluid and stool, plus the stool's own height."""
    height = appearance.bump_mm * SolidNoise(4.0, 0.35, rng, slope=0.8)(points) if appearance.bump_mm else None
    if velvet is not None:
        height = velvet if height is None else height + velvet
    if coating is None:
        return height
    rough = np.zeros_like(coating.fluid) if height is None else height
    return rough * (1 - 0.9 * np.minimum(2 * coating.fluid, 1)) * (1 - 0.7 * coating.stool) + coating.height_mm


def _tilted(normals: Floats, points: Floats, height: Floats | None, texel_mm: float) -> Floats:
    """Smooth normals tilted by the gradient of a fine height field (Blinn 1978), (rows, columns, 3)."""
    if height is None:
        return _unit(normals)
    tilted = normals.copy()
    for axis in (0, 1):
        tangent = np.gradient(points, axis=axis)  # mm per texel
        squared = np.maximum(np.einsum("hwc,hwc->hw", tangent, tangent), (0.2 * texel_mm) ** 2)
        tilted -= (np.gradient(height, axis=axis) / squared)[..., None] * tangent
    return _unit(tilted)


def _unit(vectors: Floats) -> Floats:
    """Vectors (...,3) over their lengths."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
