"""Obstacles between lens and wall: mucosa on the lens, a water jet, foam, a forceps.

Each function takes a view of the bare wall and returns radiance (H,W,3) and the pixels (H,W) in which the wall is
hidden: there truth has no depth, because nothing of the wall can be measured there.
Camera axes, millimetres; brightness as in `shading`. Every random number comes from the slot's own generator, so
that frames can be made in any order.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.phantom.config import ImagingConfig
from haustra.phantom.imaging.camera import Camera
from haustra.phantom.imaging.forceps import draw_forceps
from haustra.phantom.timeline import Slot

Floats = NDArray[np.float32]
Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
HIDDEN = 0.12  # opacity from which the wall counts as hidden
NOZZLE_MM = np.array([-4.0, 2.5, 1.0])  # camera axes
SPRAY_MM = 30.0  # z at which the jet is aimed, roughly the wall's
FOAM = 70  # bubbles in a patch of foam


@dataclass(frozen=True)
class View:
    """A frame of the bare wall, as obstacles take it."""

    camera: Camera
    imaging: ImagingConfig
    rays: Floats  # (H,W,3) unit directions
    world_from_camera: Array  # (4,4), mm
    points: Floats  # (H,W,3) wall, camera axes
    radiance: Floats  # (H,W,3)
    foam: Array  # (K,4) bubbles on the wall: x y z (world mm) and radius mm


def red_out(view: View, slot: Slot, frame: int, rng: np.random.Generator) -> tuple[Floats, Mask]:
    """Mucosa on the lens: the image turns red and loses all detail."""
    shape = view.radiance.shape[:2]
    strength = slot.strength(frame)
    clouds = _clouds(shape, rng, shift=2.0 * slot.part(frame))
    glow = np.float32(0.9) * (1 + 0.25 * clouds[..., None]) * np.array([1.0, 0.075, 0.04], np.float32)
    blurred = cv2.GaussianBlur(view.radiance, (0, 0), 1.0 + 0.06 * strength * shape[1])
    return blurred + np.float32(strength) * (glow - blurred), np.full(shape, strength > HIDDEN)


def water_jet(view: View, slot: Slot, frame: int, rng: np.random.Generator) -> tuple[Floats, Mask]:
    """Water jet: a bright, streaky fan from the nozzle to the wall, and a changing splash where it lands."""
    height, width = view.radiance.shape[:2]
    target = np.array([*rng.uniform(-9, 9, 2), SPRAY_MM]) + 0.7 * np.sin(0.9 * frame + np.arange(3))
    start, end = _visible_line(view.camera, NOZZLE_MM, target)
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    along, across = _line_coordinates(np.stack([x, y], axis=-1), start, end)
    spread = (0.012 + 0.035 * np.clip(along, 0, 1)) * width
    fan = np.exp(-((across / spread) ** 2)) * (along > -0.2) * (along < 1.0)
    moment = np.random.default_rng([int(rng.integers(2**31)), frame])
    streaks = 0.65 + 0.5 * _streaks(along, across / spread, moment)
    splash = np.exp(-((np.hypot(x - end[0], y - end[1]) / (0.11 * width)) ** 2))
    foam = np.clip(splash * (0.95 + 0.6 * _clouds((height, width), moment, size=0.03)), 0, 1)
    opacity = slot.strength(frame) * np.clip(0.75 * fan * streaks + 0.8 * foam, 0, 0.95).astype(np.float32)
    white = np.array([0.85, 0.87, 0.85], np.float32) * _brightness_of(view)
    return view.radiance + opacity[..., None] * (white - view.radiance), opacity > HIDDEN


def bubbles(view: View, slot: Slot, frame: int, rng: np.random.Generator) -> tuple[Floats, Mask]:
    """Foam that sticks to the wall: each bubble shows a bright rim, a dark ring and the lights' reflections."""
    radiance = view.radiance.copy()
    hidden = np.zeros(radiance.shape[:2], bool)
    world_from_camera = view.world_from_camera
    centres = (view.foam[:, :3] - world_from_camera[:3, 3]) @ world_from_camera[:3, :3]
    life = rng.uniform(0.0, 0.35, len(centres))  # share of the slot after which each appears and before which it bursts
    near_first = np.argsort(-centres[:, 2])
    for index in near_first:
        if min(slot.part(frame), 1 - slot.part(frame)) >= life[index]:
            _one_bubble(view, radiance, hidden, centres[index], float(view.foam[index, 3]))
    return radiance, hidden


def tool(view: View, slot: Slot, frame: int, rng: np.random.Generator) -> tuple[Floats, Mask]:
    """A biopsy forceps that comes out of its channel, opens and goes back."""
    return draw_forceps(view.rays, view.points, view.radiance, view.imaging, slot.strength(frame), slot.part(frame))


Obstacle = Callable[[View, Slot, int, np.random.Generator], tuple[Floats, Mask]]
OBSTACLES: dict[str, Obstacle] = {"red_out": red_out, "water_jet": water_jet, "bubbles": bubbles, "tool": tool}


def place_foam(points: Floats, world_from_camera: Array, rng: np.random.Generator) -> Array:
    """Bubbles (K,4) around one place of the wall in the middle of a frame: world x y z and radius, mm."""
    rows, columns = points.shape[0] // 5, points.shape[1] // 5
    middle = points[rows:-rows, columns:-columns]
    wall = middle[middle[..., 2] > 3.0].reshape(-1, 3).astype(float)
    if not len(wall):
        return np.empty((0, 4))
    wall = wall[(wall[:, 2] < 45.0) | (wall[:, 2] <= np.quantile(wall[:, 2], 0.3))]
    seat = wall[rng.integers(len(wall))]
    near = wall[np.linalg.norm(wall - seat, axis=1) < 0.35 * seat[2]]
    seats = near[rng.integers(len(near), size=FOAM)]
    radii = np.exp(rng.uniform(np.log(0.3), np.log(0.05 * seat[2] + 0.6), FOAM))
    lifted = seats - 0.6 * radii[:, None] * seats / np.linalg.norm(seats, axis=1, keepdims=True)
    return np.concatenate([lifted @ world_from_camera[:3, :3].T + world_from_camera[:3, 3], radii[:, None]], axis=1)


def _one_bubble(view: View, radiance: Floats, hidden: Mask, centre: Array, radius_mm: float) -> None:
    """Paint one bubble into `radiance` and `hidden` where the wall does not cover it."""
    height, width = hidden.shape
    if centre[2] <= 2.0:
        return
    u, v = view.camera.project(centre)
    size = radius_mm * view.camera.params[0] / centre[2]
    left, right = max(0, int(u - size)), min(width, int(u + size) + 2)
    top, bottom = max(0, int(v - size)), min(height, int(v + size) + 2)
    if size < 0.7 or left >= right or top >= bottom:
        return
    x, y = np.meshgrid(np.arange(left, right) + 0.5 - u, np.arange(top, bottom) + 0.5 - v)
    out = np.hypot(x, y) / size  # 0 in the middle, 1 at the rim
    here = (out < 1) & (view.points[top:bottom, left:right, 2] > centre[2] - 1.5 * radius_mm)
    patch = radiance[top:bottom, left:right]
    through = patch[::-1, ::-1] if patch.shape[0] > 4 else patch  # a ball of fluid inverts the image
    ring = np.exp(-(((out - 0.93) / 0.06) ** 2))[..., None]
    dark = np.exp(-(((out - 0.78) / 0.1) ** 2))[..., None]
    glint = np.exp(-(np.hypot(x / size + 0.35, y / size + 0.4) ** 2) / 0.012)[..., None]
    light = _brightness_at(centre[2])
    seen = (0.75 * patch + 0.35 * through) * (1 - 0.35 * dark) + (0.16 * ring + 1.2 * glint) * light
    patch[here] = seen[here]
    hidden[top:bottom, left:right] |= here


def _brightness_at(distance_mm: float) -> float:
    """Radiance of a white frontal wall at a distance (mm)."""
    return float((25.0 / max(distance_mm, 4.0)) ** 2)


def _brightness_of(view: View) -> np.float32:
    """90th percentile of the image's radiance, so that water looks lit by the same light."""
    return np.float32(np.quantile(view.radiance[::4, ::4].max(axis=-1), 0.9) + 1e-6)


def _visible_line(camera: Camera, start: Array, end: Array) -> tuple[Array, Array]:
    """Pixels of two points (3,), the first moved forward until it is well in front of the lens."""
    forward = start + (end - start) * max(0.0, (4.0 - start[2]) / (end[2] - start[2]))
    return camera.project(forward), camera.project(end)


def _line_coordinates(pixels: Array, start: Array, end: Array) -> tuple[Array, Array]:
    """Part of the way from start to end, and distance from the line in px, of pixels (H,W,2)."""
    way = end - start
    length = max(float(np.hypot(*way)), 1.0)
    away = pixels - start
    along = (away @ way) / length**2
    return along, (away[..., 0] * way[1] - away[..., 1] * way[0]) / length


def _streaks(along: Array, across: Array, rng: np.random.Generator) -> Array:
    """Noise that is long along the jet and fine across it."""
    texture = rng.standard_normal((24, 12)).astype(np.float32)
    x = (np.clip(across, -2, 2) + 2) * 5.5
    y = np.clip(along, 0, 1) * 6 + 2
    return cv2.remap(texture.T, y.astype(np.float32), x.astype(np.float32), cv2.INTER_LINEAR)


def _clouds(shape: tuple[int, int], rng: np.random.Generator, size: float = 0.25, shift: float = 0.0) -> Floats:
    """Smooth noise (H,W) of unit variance; features are `size` of the width."""
    count = max(3, round(1 / size))
    coarse = rng.standard_normal((count + 4, count + 4)).astype(np.float32)
    x, y = np.meshgrid(np.linspace(1, count + 1, shape[1]), np.linspace(1, count + 1, shape[0]))
    return cv2.remap(coarse, (x + shift).astype(np.float32), y.astype(np.float32), cv2.INTER_CUBIC)
