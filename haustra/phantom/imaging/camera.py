"""Lenses by COLMAP's names: pixels to rays and back.

x right, y down, z forward; the centre of the top-left pixel is (0.5, 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import PhantomError
from haustra.phantom.config import CameraConfig

Array = NDArray[np.float64]
MODELS = ("PINHOLE", "OPENCV", "OPENCV_FISHEYE")


@dataclass(frozen=True)
class Camera:
    """`params` is fx fy cx cy for PINHOLE, then k1 k2 p1 p2 for OPENCV or k1 k2 k3 k4 for OPENCV_FISHEYE."""

    model: str
    width: int
    height: int
    params: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise PhantomError(f"unknown camera model {self.model!r}; known: {', '.join(MODELS)}")
        wanted = 4 if self.model == "PINHOLE" else 8
        if len(self.params) != wanted:
            raise PhantomError(f"{self.model} takes {wanted} parameters, got {len(self.params)}")

    @property
    def matrix(self) -> Array:
        """K (3,3) for pixel centres at half integers."""
        fx, fy, cx, cy = self.params[:4]
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])

    def rays(self, shown: NDArray[np.bool_] | None = None) -> NDArray[np.float32]:
        """Unit direction of every pixel's centre, camera axes, (H,W,3).

        Outside `shown` (H,W) a lens may have no ray, as in the corners that an endoscope's mask covers: there the
        answer is some unit vector. PhantomError where it has none inside.
        """
        x, y = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        pixels = np.stack([x, y], axis=-1)
        rays = self.unproject(pixels)
        found = np.abs(self.project(rays) - pixels).max(axis=-1) < 1e-3
        if not (found if shown is None else found[shown]).all():
            raise PhantomError(f"distortion {self.params[4:]} folds over inside the image: no inverse there")
        return rays.astype(np.float32)

    def unproject(self, pixels: Array) -> Array:
        """Pixels (...,2) to unit directions (...,3)."""
        fx, fy, cx, cy = self.params[:4]
        plane = (np.asarray(pixels, float) - (cx, cy)) / (fx, fy)
        if self.model == "OPENCV_FISHEYE":
            return self._unproject_fisheye(plane)
        if self.model == "OPENCV":
            plane = self._undistort(plane)
        direction = np.concatenate([plane, np.ones_like(plane[..., :1])], axis=-1)
        return direction / np.linalg.norm(direction, axis=-1, keepdims=True)

    def project(self, points: Array) -> Array:
        """Points (...,3) in camera axes to pixels (...,2); NaN where they lie behind the lens."""
        x, y, z = np.moveaxis(np.asarray(points, float), -1, 0)
        if self.model == "OPENCV_FISHEYE":
            plane = self._fisheye_plane(x, y, z)
        else:
            depth = np.where(z > 1e-6, z, np.nan)
            plane = np.stack([x / depth, y / depth], axis=-1)
            if self.model == "OPENCV":
                plane = _distort(plane, self.params[4:])
        fx, fy, cx, cy = self.params[:4]
        return plane * (fx, fy) + (cx, cy)

    def _undistort(self, plane: Array) -> Array:
        """Inverse of `_distort` by fixed-point iteration, which converges where the distortion's slope is below 1."""
        ideal = plane
        for _ in range(50):
            ideal = np.clip(ideal + (plane - _distort(ideal, self.params[4:])), -10, 10)
        if np.abs(_distort(ideal, self.params[4:]) - plane).max() > 1e-6:
            raise PhantomError(f"distortion {self.params[4:]} folds over inside the image: no inverse there")
        return ideal

    def _fisheye_plane(self, x: Array, y: Array, z: Array) -> Array:
        """Kannala & Brandt 2006, eq. 6: the radius is an odd polynomial of the angle to the axis."""
        across = np.hypot(x, y)
        radius = _fisheye_radius(np.arctan2(across, z), self.params[4:])
        near_axis = 1.0 / np.maximum(np.abs(z), 1e-12)  # limit of radius / across on the axis
        scale = np.where(across > 1e-12, radius / np.maximum(across, 1e-12), near_axis)
        return np.stack([x * scale, y * scale], axis=-1)

    def _unproject_fisheye(self, plane: Array) -> Array:
        """Unit directions (...,3) of points (...,2) on the image plane, by Newton's method on the angle."""
        radius = np.linalg.norm(plane, axis=-1)
        angle = np.minimum(radius, np.pi)
        for _ in range(20):  # Newton; the polynomial is monotone over any lens worth simulating
            step = 1e-6
            value = _fisheye_radius(angle, self.params[4:])
            slope = (_fisheye_radius(angle + step, self.params[4:]) - value) / step
            angle = np.clip(angle - (value - radius) / np.maximum(slope, 1e-3), 0, np.pi)
        across = np.where(radius > 1e-12, np.sin(angle) / np.maximum(radius, 1e-12), 1.0)
        return np.concatenate([plane * across[..., None], np.cos(angle)[..., None]], axis=-1)

    def to_dict(self) -> dict[str, Any]:
        """What `camera.json` says about the lens."""
        return {"model": self.model, "width": self.width, "height": self.height, "params": list(self.params)}


def make_camera(config: CameraConfig) -> Camera:
    """A lens whose horizontal edge-to-edge view is `fov_deg`, principal point in the image's centre."""
    half = np.radians(config.fov_deg) / 2
    if any(config.focal_px):
        return _measured_lens(config)
    if config.model == "OPENCV_FISHEYE":
        focal = config.width / 2 / _fisheye_radius(np.array(half), config.distortion)
    elif config.model == "OPENCV":
        focal = config.width / 2 / _distort(np.array([np.tan(half), 0.0]), config.distortion)[0]
    else:
        focal = config.width / 2 / np.tan(half)
    if not np.isfinite(focal) or focal <= 0 or not _grows(config, half):
        raise PhantomError(f"distortion {config.distortion} folds over within {config.fov_deg:g} degrees: no such lens")
    lens = (float(focal), float(focal), config.width / 2, config.height / 2)
    params = lens if config.model == "PINHOLE" else lens + config.distortion
    return Camera(config.model, config.width, config.height, params)


def _measured_lens(config: CameraConfig) -> Camera:
    """The lens of `focal_px` and `centre_px`, as a calibration measured it."""
    if min(config.focal_px) <= 0:
        raise PhantomError(f"camera.focal_px: both must be positive, got {config.focal_px}")
    middle = (config.width / 2, config.height / 2)
    lens = config.focal_px + (config.centre_px if any(config.centre_px) else middle)
    return Camera(
        config.model, config.width, config.height, lens + config.distortion[: 0 if config.model == "PINHOLE" else 4]
    )


def _grows(config: CameraConfig, half: float) -> bool:
    """True if the image radius grows with the angle all the way to the horizontal edge."""
    angle = np.linspace(0, half, 200)
    if config.model == "OPENCV_FISHEYE":
        return bool((np.diff(_fisheye_radius(angle, config.distortion)) > 0).all())
    if config.model == "OPENCV":
        plane = np.stack([np.tan(angle), np.zeros_like(angle)], axis=-1)
        return bool((np.diff(_distort(plane, config.distortion)[:, 0]) > 0).all())
    return True


def _fisheye_radius(angle: Array, k: tuple[float, ...]) -> Array:
    """Radius on the image plane (focal lengths) at angles off the axis (rad)."""
    squared = angle * angle
    return angle * (1 + squared * (k[0] + squared * (k[1] + squared * (k[2] + squared * k[3]))))


def _distort(plane: Array, k: tuple[float, ...]) -> Array:
    """Distorted points (...,2) of the image plane: Brown's radial and tangential terms, k1 k2 p1 p2 as in OpenCV."""
    k1, k2, p1, p2 = k
    x, y = plane[..., 0], plane[..., 1]
    squared = x * x + y * y
    radial = 1 + squared * (k1 + squared * k2)
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (squared + 2 * x * x),
            y * radial + p1 * (squared + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=-1,
    )
