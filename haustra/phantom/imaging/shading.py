"""Shading: radiance that wall points lit from the scope's tip send into the lens.

Everything is in camera axes and millimetres, float32 (H,W,...). Brightness is relative: the gain comes later.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.phantom.config import ImagingConfig
from haustra.phantom.imaging.interreflection import bounced

Floats = NDArray[np.floating[Any]]  # float32 in practice; numpy's types widen at every scalar
Planes = Sequence[Floats]  # x, y, z, each (H,W)
REFERENCE_MM = 25.0  # a frontal white wall at this distance has radiance 1
RECAPTURE = 0.6  # share of the light leaving a tube's wall that meets wall again instead of the open ends
SPECULAR_EXPONENT_NORM = 60.0  # exponent at which a glint's peak is `specular`; sharper ones are brighter
MIN_GLINT = 1e-16  # share of a glint's peak below which it is 0: far below a grey level


def light_positions(imaging: ImagingConfig) -> Floats:
    """Light guides (L,3) mm on a ring around the lens, or beside it where they are shifted."""
    part = np.arange(imaging.lights) / max(imaging.lights, 1)
    angle = np.radians(imaging.light_roll_deg) + 2 * np.pi * part
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    return (imaging.light_offset_mm * ring + [imaging.light_shift_mm, 0.0, 0.0]).astype(np.float32)


def lobe_axis(imaging: ImagingConfig) -> Floats:
    """Unit axis (3,) of the lights' emission lobe in camera axes."""
    tilt, roll = np.radians(imaging.lobe_tilt_deg), np.radians(imaging.lobe_roll_deg)
    return np.array([np.sin(tilt) * np.cos(roll), np.sin(tilt) * np.sin(roll), np.cos(tilt)], np.float32)


def shade(
    points: Floats, normals: Floats, albedo: Floats, gloss: Floats, lit: Floats, imaging: ImagingConfig
) -> Floats:
    """Radiance (H,W,3) of wall points (H,W,3) with unit normals and linear reflectance.

    `gloss` (H,W) multiplies the glints: 1 on moist mucosa. `lit` (L,H,W) is the part of light l that arrives, 0 in
    its shadow.
    """
    place, normal = cv2.split(points), cv2.split(normals)  # planar arrays: three times as fast as (H,W,3)
    distance = np.maximum(_norm(place), 1e-3)
    view = [axis / -distance for axis in place]
    diffuse, glint = np.zeros_like(distance), np.zeros_like(distance)
    for light, free in zip(light_positions(imaging), lit):
        lambert, mirror = _one_light(place, normal, view, light, imaging)
        diffuse += lambert * free
        if imaging.specular:
            glint += mirror * free
    diffuse /= max(imaging.lights, 1)
    glint *= gloss
    glint /= max(imaging.lights, 1)
    # Ambient light was reflected by tissue, so it is redder, and it falls off more slowly.
    tint = imaging.ambient * REFERENCE_MM / (distance + 5.0)
    planes, matt = [], []
    for paint, colour in zip(cv2.split(albedo), np.asarray(imaging.light_colour, np.float32)):
        radiance = paint * diffuse
        if imaging.ambient:
            radiance += paint * paint * 2.4 * tint
        if imaging.bounce:
            matt.append(radiance * colour)
        radiance += glint
        radiance *= colour
        planes.append(radiance)
    direct = cv2.merge(planes)
    if not imaging.bounce:
        return direct
    # Glints light no other wall. Multiple reflections: a geometric series in albedo, channel by channel.
    further = albedo / (1 - np.float32(RECAPTURE) * albedo)
    return direct + np.float32(imaging.bounce) * further * bounced(points, normals, cv2.merge(matt))


def _one_light(
    place: Planes, normal: Planes, view: Planes, light: Floats, imaging: ImagingConfig
) -> tuple[Floats, Floats]:
    """Diffuse and specular factors (H,W) of one light at (3,) mm."""
    towards = [at - axis for at, axis in zip(light, place)]
    distance = np.maximum(_norm(towards), 1e-3)
    for axis in towards:
        axis /= distance
    arriving = (REFERENCE_MM / distance) ** 2
    if imaging.light_lobe:
        along = -_dot(list(lobe_axis(imaging)), towards) if imaging.lobe_tilt_deg else -towards[2]
        arriving = arriving * np.maximum(along, 0.0) ** imaging.light_lobe
    cosine = _dot(normal, towards)
    lambert = arriving * np.maximum((cosine + imaging.wrap) / (1 + imaging.wrap), 0.0)
    if not imaging.specular:
        return lambert, lambert
    half = [a + b for a, b in zip(towards, view)]  # Blinn 1977
    aligned = np.maximum(_dot(normal, half) / np.maximum(_norm(half), 1e-6), 0.0) * (cosine > 0)
    sharpness = imaging.specular * imaging.shininess / SPECULAR_EXPONENT_NORM
    return lambert, arriving * sharpness * _lobe(aligned, imaging.shininess)


def _lobe(aligned: Floats, exponent: float) -> Floats:
    """`aligned**exponent` (H,W), 0 below MIN_GLINT, where the slow power is saved."""
    shines = np.flatnonzero(aligned > np.float32(MIN_GLINT ** (1 / max(exponent, 1e-3))))
    lobe = np.zeros(aligned.shape, np.float32)
    lobe.ravel()[shines] = aligned.ravel()[shines] ** exponent
    return lobe


def _dot(a: Planes, b: Planes) -> Floats:
    """Dot product (H,W)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _norm(a: Planes) -> Floats:
    """Length (H,W)."""
    return np.sqrt(_dot(a, a))
