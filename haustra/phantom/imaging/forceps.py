"""A biopsy forceps as three capsules (a shaft and two jaws), cast analytically and lit like the wall."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from haustra.phantom.config import ImagingConfig
from haustra.phantom.imaging.shading import shade

Floats = NDArray[np.float32]
Array = NDArray[np.float64]
CHANNEL_MM = np.array([3.6, 4.2, -2.0])  # end of the working channel, camera axes
AIM_MM = np.array([0.8, 1.0, 18.0])  # point that the shaft is aimed at, camera axes
REACH_MM = (5.0, 15.0)  # length outside the channel when just out of view, and when fully out
SHAFT_MM = 1.15  # radius; channels are 2.8 or 3.2 mm wide
JAW_MM, JAW_LENGTH_MM = 0.8, 5.0  # radius and length
JAW_OPEN_DEG = 38.0
COIL_MM = 0.9  # pitch of the wound sheath
STEEL, SHEEN = 0.16, 1.5  # reflectance, and glints relative to moist mucosa's


def draw_forceps(
    rays: Floats, points: Floats, radiance: Floats, imaging: ImagingConfig, out: float, opening: float
) -> tuple[Floats, NDArray[np.bool_]]:
    """Radiance (H,W,3) with the tool in it, and its pixels (H,W).

    `out` 0 to 1 is how far it is out of the channel; `opening` 0 to 1 is the share of its slot that has passed, over
    which the jaws open and close.
    """
    aim = (AIM_MM - CHANNEL_MM) / np.linalg.norm(AIM_MM - CHANNEL_MM)
    tip = CHANNEL_MM + aim * _reach(aim, points, rays, out)
    spread = np.radians(JAW_OPEN_DEG) * np.sin(np.pi * np.clip(opening, 0, 1)) ** 2
    side = np.cross(aim, [0.0, 1.0, 0.0])
    capsules = [(CHANNEL_MM, tip, SHAFT_MM)]
    for sign in (-1, 1):
        jaw = aim * np.cos(spread) + sign * side * np.sin(spread)
        capsules.append((tip, tip + JAW_LENGTH_MM * jaw, JAW_MM))
    length, normal, along = _nearest_capsule(rays, capsules)
    wall = np.linalg.norm(points, axis=-1)
    hit = np.isfinite(length) & (rays[..., 2] > 0) & ((length < wall) | (wall == 0))
    if not hit.any():
        return radiance, hit
    surface = (rays * np.where(hit, length, 1.0)[..., None]).astype(np.float32)
    coil = 1 + 0.25 * np.sin(2 * np.pi * along / COIL_MM)
    albedo = np.repeat((STEEL * coil)[..., None], 3, axis=-1).astype(np.float32)
    gloss = np.full(hit.shape, SHEEN, np.float32)
    lit = np.ones((imaging.lights, *hit.shape), np.float32)
    steel = shade(surface, normal.astype(np.float32), albedo, gloss, lit, replace(imaging, bounce=0.0))
    return np.where(hit[..., None], steel, radiance).astype(np.float32), hit


def _reach(aim: Array, points: Floats, rays: Floats, out: float) -> float:
    """Length (mm) outside the channel, bounded so that the jaws end before the wall."""
    wanted = REACH_MM[0] + (REACH_MM[1] - REACH_MM[0]) * out
    towards = CHANNEL_MM + aim * (wanted + JAW_LENGTH_MM)
    row, column = np.unravel_index(np.argmax(rays @ (towards / np.linalg.norm(towards))), rays.shape[:2])
    wall = float(np.linalg.norm(points[row, column]))
    free = wall - JAW_LENGTH_MM - 1.5 if wall > 0 else wanted
    return float(np.clip(free, 1.0, wanted))


def _nearest_capsule(rays: Floats, capsules: list[tuple[Array, Array, float]]) -> tuple[Array, Array, Array]:
    """First hits of rays from the origin: length (H,W), outward normal (H,W,3), place along the capsule mm (H,W)."""
    length = np.full(rays.shape[:2], np.inf)
    normal, along = np.zeros(rays.shape), np.zeros(rays.shape[:2])
    for start, end, radius in capsules:
        t = _ray_capsule(rays.astype(float), start, end, radius)
        nearer = t < length
        if not nearer.any():
            continue
        axis = (end - start) / np.linalg.norm(end - start)
        place = rays[nearer] * t[nearer][:, None]
        part = np.clip((place - start) @ axis, 0, np.linalg.norm(end - start))
        away = place - (start + part[:, None] * axis)
        normal[nearer] = away / np.linalg.norm(away, axis=-1, keepdims=True)
        along[nearer], length[nearer] = part, t[nearer]
    return length, normal, along


def _ray_capsule(rays: Array, start: Array, end: Array, radius: float) -> Array:
    """Length (H,W) at which unit rays from the origin enter a capsule; infinite where they miss it."""
    axis = end - start
    squared = float(axis @ axis)
    # Cylinder: the part of the ray across the axis meets a circle.
    d, o = rays @ axis, float(-start @ axis)
    a = squared - d * d
    b = squared * (rays @ -start) - o * d
    c = squared * float(start @ start) - o * o - radius * radius * squared
    root = b * b - a * c
    with np.errstate(invalid="ignore", divide="ignore"):
        t = (-b - np.sqrt(root)) / a
    place = o + t * d
    body = np.where((root > 0) & (place > 0) & (place < squared) & (t > 0), t, np.inf)
    return np.minimum(body, np.minimum(_ray_ball(rays, start, radius), _ray_ball(rays, end, radius)))


def _ray_ball(rays: Array, centre: Array, radius: float) -> Array:
    """Length (H,W) at which unit rays from the origin enter a sphere; infinite where they miss it."""
    b = rays @ centre
    root = b * b - float(centre @ centre) + radius * radius
    t = b - np.sqrt(np.maximum(root, 0))
    return np.where((root > 0) & (t > 0), t, np.inf)
