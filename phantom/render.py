"""A phantom that can be filmed: mesh, texture, lens and light put together."""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from phantom.camera import make_camera
from phantom.colon import build_colon
from phantom.config import CameraConfig, ImagingConfig, PhantomConfig
from phantom.raycaster import Hits, RayCaster
from phantom.sensor import Sensor, smear
from phantom.shading import light_positions, shade
from phantom.texture import SurfaceTexture

Floats = NDArray[np.float32]
Array = NDArray[np.float64]
PENUMBRA_PX = 1.2  # light guides are not points
SHADOW_REACH = 0.99  # shadow rays stop short of the wall they end on


@dataclass(frozen=True)
class Frame:
    """One picture with its truth."""

    image: NDArray[np.uint8]  # (H,W,3) RGB
    depth: Floats  # (H,W) z-depth mm, 0 where no wall is seen
    triangle: NDArray[np.int64]  # (H,W) index of the triangle seen, -1 where none


class Phantom:
    """One colon, painted, with a camera. Geometry and texture are built once; frames are cheap."""

    def __init__(self, config: PhantomConfig, threads: int = 0) -> None:
        self.config = config
        self.camera = make_camera(config.camera)
        self.colon = build_colon(config.anatomy, config.seed)
        self.caster = RayCaster(self.colon.vertices, self.colon.triangles, threads)
        self.texture = SurfaceTexture(self.colon, config.appearance, config.seed)
        self.rays = self.camera.rays()

    def seen_through(self, imaging: ImagingConfig, lens: CameraConfig) -> Phantom:
        """The same colon under another light, lens and processor; shares mesh and texture."""
        other = copy(self)
        other.config = replace(self.config, imaging=imaging, camera=lens)
        other.camera = make_camera(lens)
        other.rays = other.camera.rays()
        return other

    def film(self, poses: Array) -> Iterator[Frame]:
        """Frames along world_from_camera (N,4,4); the gain adapts from one to the next."""
        sensor = Sensor(self.config.imaging, self.camera.width, self.camera.height)
        for index, pose in enumerate(poses):
            upcoming = poses[min(index + 1, len(poses) - 1)]
            yield self.shoot(pose, upcoming, sensor, np.random.default_rng([self.config.seed, 3, index]))

    def shoot(self, pose: Array, upcoming: Array, sensor: Sensor, rng: np.random.Generator) -> Frame:
        """One frame from `pose`; `upcoming` is where the camera is one frame later (for motion blur)."""
        hits = self._cast(pose)
        points = self.rays * np.where(hits.valid, hits.length, 0.0)[..., None]
        radiance = self._radiance(pose, hits, points)
        shutter = self.config.imaging.shutter
        if shutter:
            radiance = smear(radiance, self._flow(points, hits.valid, pose, upcoming), shutter)
        shown = hits.valid & sensor.window & (points[..., 2] > 0)
        depth = np.where(shown, points[..., 2], 0.0).astype(np.float32)
        triangle = np.where(shown, hits.triangle.astype(np.int64), -1)
        return Frame(sensor.expose(radiance, rng), depth, triangle)

    def _cast(self, pose: Array) -> Hits:
        return self.caster.cast(pose[:3, 3], self.rays @ pose[:3, :3].T.astype(np.float32))

    def _radiance(self, pose: Array, hits: Hits, points: Floats) -> Floats:
        rotation = pose[:3, :3].astype(np.float32)
        safe = np.where(hits.valid, hits.triangle, 0)
        row, column = self.colon.grid_position(safe, hits.bary)
        albedo, normals = self.texture.sample(row, column, self._footprint(points))
        radiance = shade(points, normals @ rotation, albedo, self._lit(pose, points), self.config.imaging)
        return np.where(hits.valid[..., None], radiance, 0.0).astype(np.float32)

    def _footprint(self, points: Floats) -> Floats:
        """Size of a pixel on the wall (H,W) mm, a compromise between frontal and grazing views."""
        return 1.3 * points[..., 2] / np.float32(self.camera.params[0])

    def _lit(self, pose: Array, points: Floats) -> Floats:
        """How much of each light every point sees (L,H,W), tested at every second pixel: shadows are soft."""
        lights = light_positions(self.config.imaging)
        height, width = points.shape[:2]
        if not self.config.imaging.shadows:
            return np.ones((len(lights), height, width), np.float32)
        rotation = pose[:3, :3].astype(np.float32)
        tested = points[::2, ::2]
        lit = np.empty((len(lights), height, width), np.float32)
        for index, light in enumerate(lights):
            origin = (rotation @ light + pose[:3, 3]).astype(np.float32)
            blocked = self.caster.blocked(origin, (tested - light) @ rotation.T, SHADOW_REACH)
            soft = cv2.GaussianBlur(1 - blocked.astype(np.float32), (0, 0), PENUMBRA_PX)
            lit[index] = cv2.resize(soft, (width, height))
        return lit

    def _flow(self, points: NDArray[Any], valid: NDArray[np.bool_], pose: Array, upcoming: Array) -> Floats:
        """Where each pixel's wall point goes by the next frame (H,W,2) px; 0 where unknown."""
        then_from_now = np.linalg.inv(upcoming) @ pose
        moved = points @ then_from_now[:3, :3].T + then_from_now[:3, 3]
        flow = self.camera.project(moved) - self.camera.project(points)
        return np.where(valid[..., None] & np.isfinite(flow), flow, 0.0).astype(np.float32)
