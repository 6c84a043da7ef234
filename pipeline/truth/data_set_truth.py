"""What a reader of a data set's truth gives: poses by frame, and the surface that depth images show."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from haustra.core.camera import Camera
from haustra.core.errors import HaustraError
from haustra.core.ray_table import RayTable
from haustra.core.text import read_text
from reconstruction.evaluation.coverage_metrics import TrueWall
from reconstruction.evaluation.reference_surface import SPACING_MM, ReferenceSurface, reference_from_views

Array = NDArray[np.float64]
MOST_VIEWS = 100  # depth images that make the surface, spread over the film


@dataclass(frozen=True)
class DataSetTruth:
    """world_from_camera (N,4,4), OpenCV's axes, mm; row k is of frame k of the film, or of time seconds (N,) where
    there are any. depths: z-depth (H,W) in mm of each frame, 0 = none; camera: of them, at its own size; None without
    depth. wall: whose faces know whether any frame saw them."""

    world_from_camera: Array
    seconds: Array | None = None
    depths: Iterable[NDArray[np.float32]] = field(default_factory=tuple)
    camera: Camera | None = None
    wall: TrueWall | None = None

    def surface(
        self, spacing_mm: float = SPACING_MM, asked: NDArray[np.bool_] | None = None
    ) -> ReferenceSurface | None:
        """Reference surface from the depth images; None without any. asked: (N,) which frames are to be taken."""
        if self.camera is None:
            return None
        return reference_from_views(self._views(self.camera, asked), spacing_mm=spacing_mm)

    def _views(self, camera: Camera, asked: NDArray[np.bool_] | None) -> Iterator[tuple[Array, Array]]:
        asked = np.ones(len(self.world_from_camera), bool) if asked is None else asked
        rays, step = None, views_apart(int(asked.sum()))
        for number, (depth, world_from_camera) in enumerate(zip_longest(self.depths, self.world_from_camera)):
            if depth is None or world_from_camera is None:
                kinds = ("poses", "depth images") if depth is None else ("depth images", "poses")
                raise HaustraError(
                    f"the truth has {number} {kinds[1]} and more {kinds[0]}, so that they cannot be paired: give the "
                    "whole data set, or a trajectory file alone"
                )
            if number % step or not asked[number]:
                continue
            rays = _rays(camera, depth.shape) if rays is None else rays
            known = (depth > 0) & (rays[1] > 0)
            points = rays[0][known] * depth[known, None].astype(np.float64)
            yield points @ world_from_camera[:3, :3].T + world_from_camera[:3, 3], depth[known].astype(np.float64)


def views_apart(count: int) -> int:
    """Every how many of so many frames makes the surface."""
    return max(1, count // MOST_VIEWS)


def _rays(camera: Camera, shape: tuple[int, ...]) -> tuple[Array, NDArray[np.uint8]]:
    """Rays (H,W,3) of z = 1 through the pixels' centres, and which pixels (H,W) have one."""
    height, width = shape
    scale = width / camera.width
    if abs(camera.height * scale - height) > 1.5:
        raise HaustraError(f"depth of {width}x{height} pixels is not of the lens for {camera.width}x{camera.height}")
    camera = camera.cropped_and_scaled(0, 0, camera.width, camera.height, scale)
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    plane, _ = camera.unproject(np.stack([x.ravel(), y.ravel()], axis=1))
    usable = RayTable(camera).usable
    return np.column_stack([plane, np.ones(len(plane))]).reshape(height, width, 3), usable[:height, :width]


def rotations_of(path: Path, quaternions: Array) -> Array:
    """Rotation matrices (N,3,3) of quaternions x y z w (N,4) in a file. HaustraError where one has no direction."""
    nothing = np.flatnonzero(np.linalg.norm(quaternions, axis=1) < 1e-9)
    if len(nothing):
        raise HaustraError(f"{path} has a quaternion of length 0 as pose {nothing[0] + 1}")
    return np.asarray(Rotation.from_quat(quaternions).as_matrix())


def table_of(path: Path, columns: int, delimiter: str | None = None, skip: int = 0) -> Array:
    """Numbers (N,columns) of a text file, after `skip` lines. HaustraError, one sentence, for any other content."""
    rows = [line.split(delimiter) for line in read_text(path).splitlines()[skip:] if line.strip()]
    try:
        table = np.array(rows, np.float64)
    except ValueError as error:
        raise HaustraError(f"{path} must have {columns} numbers on each line") from error
    if table.ndim != 2 or table.shape[1] != columns or not np.isfinite(table).all():
        raise HaustraError(f"{path} must have {columns} finite numbers on each line")
    return table
