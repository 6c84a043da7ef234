"""Distorted frames to a pinhole's: the completion network and fusion then need no lens model.

The pinhole is the widest useful one: as wide as the source along its axes, but no wider than a stated field of view,
beyond which a pinhole image is mostly stretched border. Corners of a barrel image are cut. How much of the source is
kept is counted and reported.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera

MAX_FOV_DEG = 120.0  # a pinhole image wider than this is mostly stretched border


@dataclass(frozen=True)
class Rectifier:
    """Maps from a working frame, as filmed through its lens, to a pinhole's image. For a pinhole it changes nothing."""

    camera: Camera
    map_xy: NDArray[np.float32] | None  # (H,W,2), OpenCV's integer-centre pixels
    kept_share: float  # of the source's pixels that the pinhole still shows

    def image(self, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Resample (H,W,3) bilinearly; black where the source shows nothing."""
        if self.map_xy is None:
            return rgb
        return cv2.remap(rgb, self.map_xy, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)

    def mask(self, mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Resample a mask by nearest neighbour; zero where the source shows nothing."""
        if self.map_xy is None:
            return mask
        return cv2.remap(mask, self.map_xy, None, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)


def make_rectifier(camera: Camera, max_fov_deg: float = MAX_FOV_DEG) -> Rectifier:
    """Rectifier of the working frames' camera. max_fov_deg: of the pinhole, at most."""
    if camera.is_pinhole:
        return Rectifier(_as_pinhole(camera), None, 1.0)
    pinhole = _widest_pinhole(camera, max_fov_deg)
    columns, rows = np.meshgrid(np.arange(pinhole.width) + 0.5, np.arange(pinhole.height) + 0.5)
    (fx, fy), (cx, cy) = pinhole.focal, pinhole.centre
    rays = np.stack([(columns - cx) / fx, (rows - cy) / fy, np.ones_like(rows)], axis=-1).reshape(-1, 3)
    source = camera.project(rays).reshape(pinhole.height, pinhole.width, 2)
    source[~_within_valid_radius(camera, rays).reshape(source.shape[:2])] = -10
    return Rectifier(pinhole, (source - 0.5).astype(np.float32), _kept_share(camera, source))


def _as_pinhole(camera: Camera) -> Camera:
    return Camera("PINHOLE", camera.width, camera.height, (*camera.focal, *camera.centre), camera.trusted)


def _widest_pinhole(camera: Camera, max_fov_deg: float) -> Camera:
    """Same pixel count and centre as the source; a common focal length that fits the wider side."""
    fov = max(camera.field_of_view())
    half = math.radians(min(fov, max_fov_deg) / 2)
    focal = min(
        0.5 * max(camera.width, camera.height) / math.tan(half),
        camera.focal_px * 1.25,  # never magnify much: no detail would be gained
    )
    centre_x = camera.width / 2 + (camera.centre[0] - camera.width / 2) * focal / camera.focal[0]
    centre_y = camera.height / 2 + (camera.centre[1] - camera.height / 2) * focal / camera.focal[1]
    return Camera("PINHOLE", camera.width, camera.height, (focal, focal, centre_x, centre_y), camera.trusted)


def _within_valid_radius(camera: Camera, rays: NDArray[np.float64]) -> NDArray[np.bool_]:
    """False where a polynomial lens model has turned back on itself, far outside the image it was fitted to."""
    angle = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
    return angle < camera.lens.valid_angle(camera.distortion)


def _kept_share(camera: Camera, source: NDArray[np.float64]) -> float:
    """Share of source pixels (on a 4-pixel grid) that some pinhole pixel looks at."""
    cells = np.zeros((camera.height // 4 + 1, camera.width // 4 + 1), dtype=bool)
    x, y = np.floor(source.reshape(-1, 2).T / 4).astype(int)
    inside = (x >= 0) & (y >= 0) & (x < camera.width // 4) & (y < camera.height // 4)
    cells[y[inside], x[inside]] = True
    return float(cells[: camera.height // 4, : camera.width // 4].mean())
