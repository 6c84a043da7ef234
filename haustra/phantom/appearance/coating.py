"""Coating of the wall: stool in patches, and a film of turbid fluid on the low side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from haustra.phantom.appearance.vessels import SheetScale
from haustra.phantom.config import AppearanceConfig
from haustra.phantom.noise import SolidNoise

Floats = NDArray[np.float32]
GLOSS_STOOL, GLOSS_FLUID = 0.05, 3.0  # glints relative to moist mucosa's
STOOL_MM = 0.6  # thickness of a patch
STOOL_RIM = 0.08  # width of a patch's rim, in standard deviations of the noise whose level set it is
STOOL_MOTTLE = 0.16  # relative standard deviation of stool's reflectance
FLUID_RIM = 0.12  # width of the film's rim, in the same unit
FLUID_DEPTH = 0.6  # noise level above the rim at which the film is opaque
FLUID_LEVEL = 1.6  # weight of gravity over that of noise: little fluid is left on the roof


@dataclass(frozen=True)
class Coating:
    """Opacities (rows, columns) in [0,1] of stool and fluid on the sheet, and the stool's thickness in mm."""

    stool: Floats
    fluid: Floats
    height_mm: Floats

    def paint(self, albedo: Floats, appearance: AppearanceConfig, points: Floats, rng: np.random.Generator) -> Floats:
        """Reflectance (rows, columns, 3) of the coated wall; stool covers fluid."""
        tint = 1 - self.fluid[..., None] * (1 - np.asarray(appearance.fluid_colour, np.float32))
        albedo = albedo * tint
        if not self.stool.any():
            return albedo
        mottle = np.exp(STOOL_MOTTLE * SolidNoise(5.0, 0.5, rng, slope=0.4)(points))[..., None]
        dung = np.asarray(appearance.stool_colour, np.float32) * mottle
        return albedo + self.stool[..., None] * (dung - albedo)

    def gloss(self) -> Floats:
        """Strength of glints (rows, columns) relative to bare mucosa."""
        gloss = 1 + self.fluid * (GLOSS_FLUID - 1)
        return gloss + self.stool * (GLOSS_STOOL - gloss)


def upwards(seed: int) -> Floats:
    """Unit vector (3,) against gravity, random per colon: patients lie on any side."""
    up = np.random.default_rng([seed, 7]).standard_normal(3)
    return (up / np.linalg.norm(up)).astype(np.float32)


def coat(points: Floats, normals: Floats, appearance: AppearanceConfig, seed: int) -> Coating:
    """Coating of the wall at points and normals (rows, columns, 3), over the shares of its area in the config."""
    rng = np.random.default_rng([seed, 5])
    weight = SheetScale(points).texel_mm2()
    none = np.zeros(points.shape[:2], np.float32)
    stool, height, fluid = none, none, none
    if appearance.stool:
        field = _patches(points, rng)
        above = field - _cut(field, weight, appearance.stool)
        stool = np.clip(above / STOOL_RIM + 0.5, 0, 1)
        height = STOOL_MM * np.tanh(np.maximum(above + 0.5 * STOOL_RIM, 0) / 0.4)
    if appearance.fluid:
        lowness = normals @ upwards(seed)  # normals point into the lumen: up on the floor
        field = FLUID_LEVEL * lowness + 0.35 * SolidNoise(30.0, 6.0, rng).coarsely(points, 4)
        above = field - _cut(field, weight, appearance.fluid)
        fluid = np.clip(above / FLUID_RIM + 0.5, 0, 1) * np.clip(0.5 + 0.5 * above / FLUID_DEPTH, 0.5, 1)
    return Coating(stool, fluid, height)


def _patches(points: Floats, rng: np.random.Generator) -> Floats:
    """Noise (rows, columns) whose level sets are ragged at three scales: 7-40, 2-7 and 0.4-2 mm."""
    field = SolidNoise(40.0, 7.0, rng).coarsely(points, 4)
    field += 0.5 * SolidNoise(7.0, 2.0, rng).coarsely(points, 4)
    return field + 0.2 * SolidNoise(2.0, 0.4, rng, slope=0.3)(points)


def _cut(field: Floats, weight: Floats, part: float) -> float:
    """The level of `field` above which a share `part` of the area lies; `weight` (rows, columns): texels' areas."""
    values, areas = field[::2, ::2].ravel(), weight[::2, ::2].ravel()
    order = np.argsort(values)
    below = np.cumsum(areas[order], dtype=float)
    return float(values[order][min(np.searchsorted(below, (1 - part) * below[-1]), len(order) - 1)])
