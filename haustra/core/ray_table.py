"""Table of a camera's rays: pixels of any lens model as points of the plane z = 1, so that what follows knows no lens.

A residual is measured where the noise is, in pixels: to first order about an observation it is `jacobian @ (xy -
xy_observed)` with `jacobian` = d pixel / d xy there. For a pinhole that is exact. Rays and jacobians are tabulated once
per camera, on the corners of the pixels, and read by bilinear interpolation; nothing is solved per frame.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import WIDEST, Camera
from haustra.core.numba_cache import compiled

# Largest error of unprojecting a projected point, relative to 1 + its distance from the axis on the plane z = 1.
ROUND_TRIP = 0.05
KEPT = 2  # cameras whose tables `ray_table` keeps, 5 MB each at 320x320 px


class RayTable:
    """Rays of a camera's pixels. `project` is the camera's own."""

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        columns, rows = np.meshgrid(np.arange(camera.width + 1.0), np.arange(camera.height + 1.0))
        pixels = np.stack([columns.ravel(), rows.ravel()], axis=1)
        plane, valid = camera.unproject(pixels)
        table = np.concatenate([plane, camera.pixel_jacobian(plane).reshape(-1, 4)], axis=1)
        self._table = table.reshape(camera.height + 1, camera.width + 1, 6)
        self._plane = np.ascontiguousarray(self._table[..., :2])
        corners = valid.reshape(camera.height + 1, camera.width + 1)
        self.usable = (corners[1:, 1:] & corners[:-1, 1:] & corners[1:, :-1] & corners[:-1, :-1]).astype(np.uint8)

    def masked(self, mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The mask (H,W) without the pixels that have no ray here: past the widest angle or outside the lens model."""
        return np.where(self.usable > 0, mask, 0).astype(np.uint8)

    def unproject(self, pixels: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(N,2) pixels, COLMAP's convention -> (N,2) on the plane z = 1 and (N,2,2) jacobian, pixels per unit there."""
        read = self._read(self._table, pixels)
        return read[:, :2], read[:, 2:].reshape(-1, 2, 2)

    def _read(self, table: NDArray[np.float64], pixels: NDArray[np.floating]) -> NDArray[np.float64]:
        """(N,K) of a table (H+1,W+1,K) at pixels (N,2), between its corners."""
        return _between(table, np.ascontiguousarray(pixels, np.float64))

    def project(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """(N,3) camera points -> (N,2) pixels; NaN behind the camera or too far off the axis."""
        pixels = np.full((len(points), 2), np.nan)
        front = points[:, 2] > WIDEST**-1 * np.hypot(points[:, 0], points[:, 1])
        if front.any():
            pixels[front] = self.camera.project(np.asarray(points[front], np.float64))
        return pixels

    def project_valid(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """(N,3) camera points -> (N,2) pixels; NaN also where the pixel's own ray leads elsewhere.

        A polynomial lens turns back on itself far outside its picture: what comes back into it was never there.
        """
        pixels = self.project(points)
        known = np.isfinite(pixels).all(axis=1)
        plane = points[known, :2] / points[known, 2:]
        off = np.linalg.norm(self._read(self._plane, pixels[known]) - plane, axis=1)
        lost = ~(off <= ROUND_TRIP * (1 + np.linalg.norm(plane, axis=1)))
        pixels[np.flatnonzero(known)[lost]] = np.nan
        return pixels

    @property
    def focal_px(self) -> float:
        """Geometric mean of the camera's two focal lengths, px."""
        return self.camera.focal_px


@compiled
def _between(table: NDArray[np.float64], pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,K) of a table (H+1,W+1,K) at pixels (N,2), linear between its corners; beyond its rim what is there. NaN for
    pixels that are NaN."""
    last_y, last_x, width = table.shape[0] - 1 - 1e-6, table.shape[1] - 1 - 1e-6, table.shape[2]
    found = np.empty((len(pixels), width))
    for n in range(len(pixels)):
        u, v = min(max(pixels[n, 0], 0.0), last_x), min(max(pixels[n, 1], 0.0), last_y)
        if not (pixels[n, 0] == pixels[n, 0] and pixels[n, 1] == pixels[n, 1]):
            found[n] = np.nan
            continue
        x, y = int(u), int(v)
        right, below = u - x, v - y
        for k in range(width):
            top = table[y, x, k] * (1 - right) + table[y, x + 1, k] * right
            bottom = table[y + 1, x, k] * (1 - right) + table[y + 1, x + 1, k] * right
            found[n, k] = top * (1 - below) + bottom * below
    return found


@lru_cache(KEPT)
def ray_table(camera: Camera) -> RayTable:
    """The table of a camera: submaps share one lens, and a table takes longer to make than a frame to track."""
    return RayTable(camera)
