"""Points of a frame from its sensor's depth, few enough for completion."""

import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera
from pipeline.depth.sparse_depth import SparseDepth
from pipeline.input.sensor.sensor_depth import SensorDepth

CELL = 1 / 36  # of the width, side of a cell that gives one point to completion, which was trained on a few hundred


def sensor_points(sensor: SensorDepth, frame: int, lens: Camera, pinhole: Camera, mm_per_unit: float) -> SparseDepth:
    """Points of a frame in the pinhole's picture and in scene units, one a cell, those nearest to its middle.

    lens: of the working picture.
    """
    found = in_pinhole(sensor, frame, lens, pinhole)
    if found is None:
        return SparseDepth(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    pixels, depth, sigma = found
    chosen = one_a_cell(pixels, max(2.0, CELL * pinhole.width))
    return SparseDepth(pixels[chosen], depth[chosen] / mm_per_unit, sigma[chosen] / depth[chosen])


def in_pinhole(
    sensor: SensorDepth, frame: int, lens: Camera, pinhole: Camera
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]] | None:
    """Pixels (K,2) of the pinhole's picture, depth (K,) and standard deviation (K,), mm, of all cells of a frame that
    have depth; None for a frame without an image."""
    found = sensor.cells(frame)
    if found is None:
        return None
    working, depth, sigma = found
    inside = np.flatnonzero(((working >= 0) & (working < [lens.width, lens.height])).all(axis=1))
    plane, good = lens.unproject(working[inside])
    pixels = plane * np.array(pinhole.focal) + np.array(pinhole.centre)
    good &= (pixels >= 0).all(axis=1) & (pixels < [pinhole.width, pinhole.height]).all(axis=1)
    known = inside[good]
    return pixels[good], depth[known], sigma[known]


def one_a_cell(pixels: NDArray[np.float64], side: float) -> NDArray[np.int64]:
    """Rows of the pixel nearest to the middle in each square of the picture: to choose by the error would choose by the
    depth, and at the edge of a fold always the same side of it."""
    off = np.linalg.norm(pixels / side - np.floor(pixels / side) - 0.5, axis=1)
    order = np.lexsort((pixels[:, 0], pixels[:, 1], off))
    cell = np.floor(pixels[order] / side).astype(np.int64)
    _, first = np.unique(cell[:, 1] * 100_000 + cell[:, 0], return_index=True)
    return np.sort(order[first])
