"""Camera models by COLMAP's names and parameter order; pixel centre of the top-left pixel at (0.5, 0.5).

Only what the pipeline needs: project, unproject, crop and scale, read and write. What asks for rays again and again
reads them from a `haustra.core.ray_table.RayTable`.
"""

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import HaustraError
from haustra.core.lenses import LENS_MODELS
from haustra.core.lenses.model import LensModel
from haustra.core.text import read_json

WIDEST = np.tan(np.radians(78.0))  # farther off the axis the plane z = 1 stretches beyond use
STEP = 1e-5  # of the finite differences, on the plane z = 1
NEWTON_STEPS = 12
CONVERGED_PX = 1e-9
GRID = 64  # points a side at which a picture is asked what the lens reaches
MAX_MISFIT_PX = 0.01  # a ray whose projection misses its pixel by more lies outside the lens model

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """Intrinsics of one image size. params in COLMAP's order; `trusted` is False for a guessed focal length."""

    model: str
    width: int
    height: int
    params: tuple[float, ...]
    trusted: bool = True

    def __post_init__(self) -> None:
        if self.model not in LENS_MODELS:
            raise HaustraError(f"unknown camera model '{self.model}'; known: {', '.join(LENS_MODELS)}")
        if len(self.params) != self.lens.parameters:
            raise HaustraError(f"{self.model} takes {self.lens.parameters} parameters, not {len(self.params)}")
        if not all(math.isfinite(p) for p in self.params) or min(self.focal) <= 0:
            raise HaustraError(f"the {self.model} camera's parameters must be finite and its focal length positive")
        if self.width < 1 or self.height < 1:
            raise HaustraError(f"a camera of {self.width}x{self.height} pixels is impossible")

    @property
    def lens(self) -> LensModel:
        return LENS_MODELS[self.model]

    @property
    def focal(self) -> tuple[float, float]:
        return (self.params[0], self.params[self.lens.focal_lengths - 1])

    @property
    def centre(self) -> tuple[float, float]:
        first = self.lens.focal_lengths
        return (self.params[first], self.params[first + 1])

    @property
    def focal_px(self) -> float:
        """Geometric mean of the two focal lengths, for thresholds on angles."""
        return math.sqrt(self.focal[0] * self.focal[1])

    @property
    def distortion(self) -> tuple[float, ...]:
        return self.params[self.lens.focal_lengths + 2 :]

    @property
    def is_pinhole(self) -> bool:
        return self.lens.straight_at_zero and not any(self.distortion)

    @property
    def matrix(self) -> NDArray[np.float64]:
        """K (3,3) in COLMAP's pixel convention."""
        (fx, fy), (cx, cy) = self.focal, self.centre
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])

    def project(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N,3) points in camera axes, z > 0 (fisheye: any z) -> (N,2) pixels."""
        uv = self.lens.distort(points, self.distortion)
        return uv * np.array(self.focal) + np.array(self.centre)

    def unproject(self, pixels: Array) -> tuple[Array, NDArray[np.bool_]]:
        """(N,2) pixels -> (N,2) points of the plane z = 1, and (N,) whether the lens model reaches them.

        In closed form where the lens model has one, else by Newton's method from its first guess; not farther off the
        axis than `WIDEST`, nor than where the model turns back on itself.
        """
        distorted = (pixels - np.array(self.centre)) / np.array(self.focal)
        exact = self.is_pinhole or self.lens.undistort is not None
        if self.lens.undistort is None:
            plane = self.lens.first_guess(distorted)
        else:
            plane = self.lens.undistort(distorted, self.distortion)
        left = np.arange(len(pixels))  # rows that have not converged
        for _ in range(0 if exact else NEWTON_STEPS):
            off = pixels[left] - self.project(_on_plane(plane[left]))
            far = np.abs(off).max(axis=1) > CONVERGED_PX
            left, off = left[far], off[far]
            jacobian = self.pixel_jacobian(plane[left])
            with np.errstate(invalid="ignore"):  # far out a polynomial overflows
                singular = ~(np.abs(np.linalg.det(jacobian)) >= 1e-6)
            jacobian[singular] = np.eye(2) * self.focal[0]
            step = np.linalg.solve(jacobian, off[:, :, None])[:, :, 0]
            plane[left] = np.clip(plane[left] + np.clip(step, -0.5, 0.5), -2 * WIDEST, 2 * WIDEST)
        misfit = np.linalg.norm(pixels - self.project(_on_plane(plane)), axis=1)
        widest = min(WIDEST, math.tan(min(self.lens.valid_angle(self.distortion), 1.5)))
        return plane, (misfit < MAX_MISFIT_PX) & (np.linalg.norm(plane, axis=1) < widest)

    def pixel_jacobian(self, plane: Array) -> Array:
        """(N,2,2) d pixel / d point of the plane z = 1, at points (N,2), by central differences."""
        columns = []
        for offset in STEP * np.eye(2):
            ahead, behind = self.project(_on_plane(plane + offset)), self.project(_on_plane(plane - offset))
            columns.append((ahead - behind) / (2 * STEP))
        return np.stack(columns, axis=2)

    def cropped_and_scaled(self, x0: int, y0: int, width: int, height: int, scale: float) -> "Camera":
        """The camera of the image after cutting out a box and resizing it."""
        (fx, fy), (cx, cy) = self.focal, self.centre
        one = self.lens.focal_lengths == 1
        focal = (fx * scale,) if one else (fx * scale, fy * scale)
        params = (*focal, (cx - x0) * scale, (cy - y0) * scale, *self.distortion)
        return replace(self, width=round(width * scale), height=round(height * scale), params=params)

    def of_whole(self, x0: int, y0: int, width: int, height: int, scale: float) -> "Camera":
        """The camera of the picture (width, height) of which this one's is a box with its corner at (x0, y0), resized
        by `scale`: `cropped_and_scaled` undone."""
        larger = self.cropped_and_scaled(0, 0, self.width, self.height, 1 / scale)
        return replace(larger.cropped_and_scaled(-x0, -y0, width, height, 1.0), width=width, height=height)

    def field_of_view(self) -> tuple[float, float]:
        """Horizontal and vertical angle in degrees, along the principal axes."""
        angles = []
        for size, focal, centre in zip((self.width, self.height), self.focal, self.centre, strict=True):
            sides = (centre / focal, (size - centre) / focal)
            angles.append(math.degrees(sum(self._angle_of_radius(r) for r in sides)))
        return angles[0], angles[1]

    def share_beyond_lens(self, box: tuple[int, int, int, int] | None = None) -> float:
        """Share of the picture, or of a box (x, y, width, height) of it, that lies farther out than where the lens
        model turns back on itself: nothing is known of the rays there. 0 for a model that grows throughout."""
        angle = self.lens.valid_angle(self.distortion)
        if angle >= self.lens.widest:
            return 0.0
        edge = np.array([[math.sin(angle), 0.0, math.cos(angle)]])
        radius = float(np.linalg.norm(self.lens.distort(edge, self.distortion)))
        x, y, width, height = box or (0, 0, self.width, self.height)
        steps = (np.arange(GRID) + 0.5) / GRID
        columns, rows = np.meshgrid(x + steps * width, y + steps * height)
        (fx, fy), (cx, cy) = self.focal, self.centre
        return float((np.hypot((columns - cx) / fx, (rows - cy) / fy) > radius).mean())

    def _angle_of_radius(self, radius: float) -> float:
        """Angle off the axis whose distorted normalised radius is `radius`, radians; that at which the lens model turns
        back on itself, where it never reaches that radius."""
        theta = np.linspace(0, self.lens.widest, 4000)
        rays = np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=1)
        growing = np.maximum.accumulate(self.lens.distort(rays, self.distortion)[:, 0])
        return min(float(np.interp(radius, growing, theta)), self.lens.valid_angle(self.distortion))

    @staticmethod
    def from_dict(values: dict[str, Any]) -> "Camera":
        """What `to_dict` gave, by way of JSON."""
        return Camera(**(values | {"params": tuple(values["params"])}))

    def to_dict(self) -> dict[str, object]:
        return {
            "model": self.model,
            "width": self.width,
            "height": self.height,
            "params": list(self.params),
            "trusted": self.trusted,
        }


def _on_plane(plane: Array) -> Array:
    return np.concatenate([plane, np.ones((len(plane), 1))], axis=1)


def read_camera(path: Path) -> Camera:
    """A camera from `camera.json` (model, width, height, params)."""
    fields = read_json(path)
    try:
        width, height = (whole_number(fields[name], name) for name in ("width", "height"))
        if not isinstance(fields["params"], list):
            raise HaustraError(f"params is {_shown(fields['params'])}, and must be a list of numbers")
        params = tuple(_number(value, "params") for value in fields["params"])
        return Camera(str(fields["model"]), width, height, params, _boolean(fields.get("trusted", True)))
    except HaustraError as error:
        raise HaustraError(f"{path}: {error}") from error
    except KeyError as error:
        raise HaustraError(f"{path} is not a camera file: it lacks {error.args[0]}") from error


def whole_number(value: Any, name: str) -> int:
    """A number of pixels as a file has it. HaustraError, with the value's name, for any other value."""
    if isinstance(value, int) and not isinstance(value, bool):
        return value  # also one too large for a float, which is refused as a size
    number = _number(value, name)
    if not number.is_integer():
        raise HaustraError(f"{name} is {_shown(value)}, and must be a whole number of pixels")
    return int(number)


def _number(value: Any, name: str) -> float:
    """HaustraError for what is no number; true and false are none, though Python counts with them."""
    try:
        if not isinstance(value, bool):
            return float(value)
    except (TypeError, ValueError, OverflowError):
        pass
    raise HaustraError(f"{name} holds {_shown(value)}, which is no number that a camera has")


def _boolean(value: Any) -> bool:
    if not isinstance(value, bool):
        raise HaustraError(f"trusted is {_shown(value)}, and must be true or false")
    return value


def _shown(value: Any) -> str:
    """As JSON writes it, and not for pages."""
    return json.dumps(value, default=str)[:40]


def guess_camera(width: int, height: int, content: tuple[int, int, int, int], fov_deg: float = 100.0) -> Camera:
    """A pinhole with two radial terms, zero, whose longer content side spans `fov_deg`; not trusted.

    100 degrees: endoscopes are labelled 140-170 degrees corner to corner, which is 90-125 along a side. Two terms, as
    many are fisheye lenses: over 118 degrees one term is off by up to 8 of 320 pixels where two are by 2.
    """
    x, y, content_width, content_height = content
    focal = 0.5 * max(content_width, content_height) / math.tan(math.radians(fov_deg / 2))
    centre = (x + content_width / 2, y + content_height / 2)
    return Camera("RADIAL", width, height, (focal, *centre, 0.0, 0.0), trusted=False)
