"""Light that rides on the tip: what radiance a wall point sends into the lens.

Everything is in camera axes and millimetres, float32 (H,W,...). Brightness is relative: the gain comes later.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phantom.config import ImagingConfig

Floats = NDArray[np.floating[Any]]  # float32 in practice; numpy's types widen at every scalar
REFERENCE_MM = 25.0  # a frontal white wall at this distance has radiance 1
SPECULAR_EXPONENT_NORM = 60.0  # glint energy is shared over its lobe: sharper glints are brighter


def light_positions(imaging: ImagingConfig) -> Floats:
    """Light guides (L,3) mm on a ring around the lens."""
    part = np.arange(imaging.lights) / max(imaging.lights, 1)
    angle = np.radians(imaging.light_roll_deg) + 2 * np.pi * part
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    return (imaging.light_offset_mm * ring).astype(np.float32)


def shade(points: Floats, normals: Floats, albedo: Floats, lit: Floats, imaging: ImagingConfig) -> Floats:
    """Radiance (H,W,3) of wall points (H,W,3) with unit normals and linear reflectance.

    `lit` (L,H,W) is the part of light l that arrives, 0 in its shadow.
    """
    distance = np.maximum(_norm(points), 1e-3)
    view = points / -distance[..., None]
    diffuse, glint = np.zeros_like(distance), np.zeros_like(distance)
    for light, free in zip(light_positions(imaging), lit):
        lambert, mirror = _one_light(points, normals, view, light, imaging)
        diffuse += lambert * free
        glint += mirror * free
    radiance = albedo * (diffuse / max(imaging.lights, 1))[..., None]
    if imaging.ambient:
        # Light from other walls has bounced off tissue, so it is redder, and falls off more slowly.
        bounced = imaging.ambient * REFERENCE_MM / (distance + 5.0)
        radiance += albedo * albedo * 2.4 * bounced[..., None]
    radiance += (glint / max(imaging.lights, 1))[..., None]
    return radiance * np.asarray(imaging.light_colour, np.float32)


def _one_light(
    points: Floats, normals: Floats, view: Floats, light: Floats, imaging: ImagingConfig
) -> tuple[Floats, Floats]:
    """Diffuse and specular factors (H,W) of one light."""
    towards = light - points
    distance = np.maximum(_norm(towards), 1e-3)
    towards /= distance[..., None]
    arriving = (REFERENCE_MM / distance) ** 2
    if imaging.light_lobe:
        arriving = arriving * np.maximum(-towards[..., 2], 0.0) ** imaging.light_lobe
    cosine = _dot(normals, towards)
    lambert = arriving * np.maximum((cosine + imaging.wrap) / (1 + imaging.wrap), 0.0)
    if not imaging.specular:
        return lambert, np.zeros_like(lambert)
    half = towards + view  # Blinn 1977
    aligned = np.maximum(_dot(normals, half) / np.maximum(_norm(half), 1e-6), 0.0) * (cosine > 0)
    sharpness = imaging.specular * imaging.shininess / SPECULAR_EXPONENT_NORM
    return lambert, arriving * sharpness * aligned**imaging.shininess


def _dot(a: Floats, b: Floats) -> Floats:
    return np.einsum("hwc,hwc->hw", a, b)


def _norm(a: Floats) -> Floats:
    return np.sqrt(_dot(a, a))
