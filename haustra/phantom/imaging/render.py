"""Rendering of a phantom: mesh, texture, lens and light to images with exact depth and triangle indices."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from haustra.phantom.anatomy.colon import build_colon
from haustra.phantom.appearance.texture import SurfaceTexture
from haustra.phantom.config import CameraConfig, ImagingConfig, PhantomConfig
from haustra.phantom.imaging.camera import make_camera
from haustra.phantom.imaging.obstacles import OBSTACLES, View, place_foam
from haustra.phantom.imaging.readout import EXPOSURES, assembled
from haustra.phantom.imaging.sensor import Sensor, border_window, smear
from haustra.phantom.imaging.shading import light_positions, shade
from haustra.phantom.motion.peristalsis import MovedWall, WallMotion
from haustra.phantom.raycaster import Hits, RayCaster
from haustra.phantom.timeline import Slot

Floats = NDArray[np.float32]
Array = NDArray[np.float64]
PENUMBRA_PX = 1.2  # blur of shadows, standard deviation: light guides are not points
SHADOW_REACH = 0.99  # length of shadow rays over the distance to the wall point, which must not block itself
MAX_OFF_AXIS_DEG = 85.0  # beyond, z-depth tends to 0 whatever the distance, and no truth is given


@dataclass(frozen=True)
class Frame:
    """One image with its truth."""

    image: NDArray[np.uint8]  # (H,W,3) RGB
    depth: Floats  # (H,W) z-depth mm, 0 where no wall is seen
    triangle: NDArray[np.int64]  # (H,W) index of the triangle seen, -1 where none


@dataclass(frozen=True)
class Look:
    """Radiance at the lens and truth of one frame, before the sensor."""

    radiance: Floats  # (H,W,3)
    wall: Floats  # (H,W) z-depth of the wall behind whatever hides it, mm; 0 = none, or seen too far off axis
    points: Floats  # (H,W,3) wall in camera axes, mm; zero where the ray leaves through an open end
    triangle: NDArray[np.int64]  # (H,W), -1 where no wall
    hidden: NDArray[np.bool_]  # (H,W) an obstacle hides the wall


class Phantom:
    """A textured colon with a camera. Geometry and texture are built once per phantom."""

    def __init__(self, config: PhantomConfig, threads: int = 0) -> None:
        """`threads` 0 uses every core; the frames do not depend on it."""
        self.config = config
        self.threads = threads or os.cpu_count() or 1
        self.camera = make_camera(config.camera)
        self.colon = build_colon(config.anatomy, config.seed)
        self.caster = RayCaster(self.colon.vertices, self.colon.triangles, 1)
        self.texture = SurfaceTexture(self.colon, config.appearance, config.seed)
        self.rays = self._camera_rays()

    def seen_through(self, imaging: ImagingConfig, lens: CameraConfig) -> Phantom:
        """The same colon under another light, lens and processor; shares mesh and texture."""
        other = copy(self)
        other.config = replace(self.config, imaging=imaging, camera=lens)
        other.camera = make_camera(lens)
        other.rays = other._camera_rays()
        return other

    def _camera_rays(self) -> Floats:
        """Rays (H,W,3) of all pixels that the border shows."""
        return self.camera.rays(border_window(self.config.imaging.border, self.camera.width, self.camera.height))

    def film(
        self, world_from_camera: Array, timeline: Sequence[Slot] = (), motion: WallMotion | None = None
    ) -> Iterator[Frame]:
        """Frames along `world_from_camera` (N,4,4); the gain adapts from one to the next.

        Radiance is rendered a few frames ahead on every core; the sensor takes it in order.
        """
        fps = self.config.motion.fps
        sensor = Sensor(self.config.imaging, self.camera.width, self.camera.height, self.config.seed, fps)
        foams = {slot.number: self._foam(world_from_camera, slot) for slot in timeline if slot.kind == "bubbles"}

        readout = self.config.imaging.readout

        def look(index: int) -> Look:
            seen = [exposed(index, index + shift) for shift in EXPOSURES[readout]]
            return replace(seen[0], radiance=assembled([part.radiance for part in seen], readout))

        def exposed(index: int, time: float) -> Look:
            walls = [motion.wall(frame) if motion else None for frame in (time, time + 1)]
            here = camera_between(world_from_camera, time)
            seen = self.look(here, camera_between(world_from_camera, time + 1), *walls)
            for slot in timeline:
                if slot.kind in OBSTACLES and slot.first <= index <= slot.last:
                    seen = self._obstructed(seen, here, slot, index, foams.get(slot.number))
            return seen

        for index, seen in enumerate(_ahead(look, len(world_from_camera), self.threads)):
            yield develop(seen, sensor, np.random.default_rng([self.config.seed, 3, index]))

    def shoot(
        self, world_from_camera: Array, next_world_from_camera: Array, sensor: Sensor, rng: np.random.Generator
    ) -> Frame:
        """One frame from `world_from_camera`; `next_world_from_camera` is one frame later, for motion blur."""
        return develop(self.look(world_from_camera, next_world_from_camera), sensor, rng)

    def look(
        self,
        world_from_camera: Array,
        next_world_from_camera: Array,
        moved: MovedWall | None = None,
        next_moved: MovedWall | None = None,
    ) -> Look:
        """Radiance and truth from one camera (4,4); the wall is at rest, or moved and moving on to `next_moved`.

        `world_from_camera` and truth are those of mid-exposure; `next_world_from_camera` gives the motion blur.
        """
        caster = self.caster if moved is None else RayCaster(moved.vertices, self.colon.triangles, self.threads)
        hits = caster.cast(world_from_camera[:3, 3], self.rays @ world_from_camera[:3, :3].T.astype(np.float32))
        points = self.rays * np.where(hits.valid, hits.length, 0.0)[..., None]
        radiance = self._radiance(world_from_camera, hits, points, caster, moved)
        shutter = self.config.imaging.shutter
        if shutter:
            moving = moved is not None or next_moved is not None
            then = self._wall_points(hits, next_moved) if moving else None
            radiance = smear(
                radiance, self._flow(points, hits.valid, world_from_camera, next_world_from_camera, then), shutter
            )
        shown = hits.valid & (self.rays[..., 2] > np.cos(np.radians(MAX_OFF_AXIS_DEG)))
        wall = np.where(shown, points[..., 2], 0.0).astype(np.float32)
        triangle = np.where(shown, hits.triangle.astype(np.int64), -1)
        return Look(radiance, wall, points, triangle, np.zeros(shown.shape, bool))

    def _radiance(
        self, world_from_camera: Array, hits: Hits, points: Floats, caster: RayCaster, moved: MovedWall | None
    ) -> Floats:
        rotation = world_from_camera[:3, :3].astype(np.float32)
        safe = np.where(hits.valid, hits.triangle, 0)
        row, column = self.colon.grid_position(safe, hits.bary)
        albedo, gloss, normals = self.texture.sample(row, column, self._footprint(points))
        if moved is not None:
            normals = normals + self._interpolated(moved.normal_change, safe, hits.bary)
            normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-6)
        lit = self._lit(world_from_camera, points, caster)
        radiance = shade(points, normals @ rotation, albedo, gloss, lit, self.config.imaging)
        return np.where(hits.valid[..., None], radiance, 0.0).astype(np.float32)

    def _interpolated(self, values: Floats, triangle: NDArray[np.uint32], bary: Floats) -> Floats:
        """Values on vertices (V,C) at surface points (H,W)."""
        corners = values[self.colon.triangles[triangle]]
        weights = np.concatenate([1 - bary.sum(axis=-1, keepdims=True), bary], axis=-1)
        return np.einsum("hwkc,hwk->hwc", corners, weights)

    def _footprint(self, points: Floats) -> Floats:
        """Footprint of a pixel on the wall (H,W) mm, 1.3 times that of a frontal view."""
        return 1.3 * _distance_ahead(points) / np.float32(self.camera.params[0])

    def _lit(self, world_from_camera: Array, points: Floats, caster: RayCaster) -> Floats:
        """Visibility (L,H,W) in [0,1] of each light from every point (H,W,3), cast at every second pixel."""
        lights = light_positions(self.config.imaging)
        height, width = points.shape[:2]
        if not self.config.imaging.shadows:
            return np.ones((len(lights), height, width), np.float32)
        rotation = world_from_camera[:3, :3].astype(np.float32)
        tested = points[::2, ::2]
        lit = np.empty((len(lights), height, width), np.float32)
        for index, light in enumerate(lights):
            origin = (rotation @ light + world_from_camera[:3, 3]).astype(np.float32)
            blocked = caster.blocked(origin, (tested - light) @ rotation.T, SHADOW_REACH)
            soft = cv2.GaussianBlur(1 - blocked.astype(np.float32), (0, 0), PENUMBRA_PX)
            lit[index] = _doubled(soft, width, height)
        return lit

    def _wall_points(self, hits: Hits, moved: MovedWall | None) -> NDArray[Any]:
        """World positions (H,W,3) mm of the surface points that were hit, on the wall at rest or moved."""
        vertices = self.colon.vertices if moved is None else moved.vertices
        return self._interpolated(vertices, np.where(hits.valid, hits.triangle, 0), hits.bary)

    def _flow(
        self,
        points: NDArray[Any],
        valid: NDArray[np.bool_],
        world_from_camera: Array,
        next_world_from_camera: Array,
        then: NDArray[Any] | None,
    ) -> Floats:
        """Optical flow (H,W,2) px of each pixel's wall point to the next frame; 0 where unknown.

        `then` (H,W,3) is the point's world position in the next frame; None if the wall is at rest.
        """
        height, width = valid.shape
        points, valid = points[::2, ::2], valid[::2, ::2]  # flow is smooth: every second pixel suffices
        world = points @ world_from_camera[:3, :3].T + world_from_camera[:3, 3] if then is None else then[::2, ::2]
        moved = (world - next_world_from_camera[:3, 3]) @ next_world_from_camera[:3, :3]
        flow = self.camera.project(moved) - self.camera.project(points)
        known = np.where(valid[..., None] & np.isfinite(flow), flow, 0.0).astype(np.float32)
        return _doubled(known, width, height)

    def _foam(self, world_from_camera: Array, slot: Slot) -> Array:
        """Bubbles (K,4) of a slot, on wall that is in view in its middle frame."""
        middle = world_from_camera[(slot.first + slot.last) // 2]
        hits = self.caster.cast(middle[:3, 3], self.rays @ middle[:3, :3].T.astype(np.float32))
        points = self.rays * np.where(hits.valid, hits.length, 0.0)[..., None]
        return place_foam(points, middle, np.random.default_rng([self.config.seed, 9, slot.number + 1]))

    def _obstructed(self, seen: Look, world_from_camera: Array, slot: Slot, frame: int, foam: Array | None) -> Look:
        nothing = np.empty((0, 4)) if foam is None else foam
        view = View(self.camera, self.config.imaging, self.rays, world_from_camera, seen.points, seen.radiance, nothing)
        rng = np.random.default_rng([self.config.seed, 7, slot.number + 1])
        radiance, hidden = OBSTACLES[slot.kind](view, slot, frame, rng)
        return replace(seen, radiance=radiance.astype(np.float32), hidden=seen.hidden | hidden)


def develop(seen: Look, sensor: Sensor, rng: np.random.Generator) -> Frame:
    """Radiance to image; truth only where the image shows the wall."""
    shown = sensor.window & ~seen.hidden
    depth, triangle = np.where(shown, seen.wall, np.float32(0)), np.where(shown, seen.triangle, -1)
    return Frame(sensor.expose(seen.radiance, rng, _distance_ahead(seen.points)), depth, triangle)


def _doubled(field: Floats, width: int, height: int) -> Floats:
    """Values at every second pixel, the first among them, interpolated to all (H,W,...)."""
    x, y = np.meshgrid(np.arange(width, dtype=np.float32) / 2, np.arange(height, dtype=np.float32) / 2)
    return cv2.remap(field, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _distance_ahead(points: Floats) -> Floats:
    """z-depth (H,W) mm, which footprint and focus depend on, kept positive beyond 84 degrees off axis."""
    return np.maximum(points[..., 2], np.float32(0.1) * np.sqrt(np.einsum("hwc,hwc->hw", points, points)))


def camera_between(world_from_camera: Array, time: float) -> Array:
    """`world_from_camera` (4,4) at a time in frames; beyond the film's ends by the motion of the frames there."""
    last = len(world_from_camera) - 1
    if time == int(time) and 0 <= time <= last:
        return world_from_camera[int(time)]
    if last == 0:
        return world_from_camera[0]
    if time == last + 1:
        return world_from_camera[-1] @ np.linalg.inv(world_from_camera[-2]) @ world_from_camera[-1]
    base = int(np.clip(np.floor(time), 0, last))
    start = min(base, last - 1)  # of the frame interval whose motion holds
    step = np.linalg.inv(world_from_camera[start]) @ world_from_camera[start + 1]
    between = np.eye(4)
    turn = Rotation.from_matrix(step[:3, :3]).as_rotvec()
    between[:3, :3] = Rotation.from_rotvec((time - base) * turn).as_matrix()
    between[:3, 3] = (time - base) * step[:3, 3]
    return world_from_camera[base] @ between


@contextmanager
def _opencv_on_one_thread() -> Iterator[None]:
    """OpenCV's own threads and ours would wait for each other: a fifth slower on two cores."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def _ahead(make: Callable[[int], Look], count: int, threads: int) -> Iterator[Look]:
    """make(0), make(1), ... in order, computed on `threads` threads, at most one frame ahead per thread."""
    if threads == 1:
        yield from map(make, range(count))
        return
    with _opencv_on_one_thread(), ThreadPoolExecutor(threads) as pool:
        waiting: deque[Future[Look]] = deque()
        for index in range(count):
            waiting.append(pool.submit(make, index))
            if len(waiting) > threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
