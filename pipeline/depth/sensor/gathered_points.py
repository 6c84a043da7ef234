"""Points of a frame from the sensor's depth of the frames around it, one in each cell of the picture.

What one frame's depth gets wrong, at the rim of a fold or on plain wall, the others get wrong elsewhere; and what hides
from one of a stereo rig's eyes shows itself some frames later. Each frame's depth is projected into the picture; in a
small cell the median of the frames is taken, and kept where most of those that have any depth there agree with it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera
from haustra.core.se3 import in_camera, inverse
from pipeline.depth.sensor.sensor_points import CELL, in_pinhole, one_a_cell
from pipeline.depth.sparse_depth import SparseDepth
from pipeline.input.sensor.sensor_depth import SensorDepth
from pipeline.mapping.submap import Submap

STEPS = (-12, -8, -4, 0, 4, 8, 12)  # rows of the submap that are asked; the next ones err alike
FINE_PX = 2  # side of a cell in which frames are compared, at least that of the sensor's own cells
SAME_WALL = 0.04  # log depth within which two frames mean one wall
FEWEST, MAJORITY = 3, 0.5  # frames that must agree, and their share of those that have depth
ALIKE = 2.0  # frames that err alike: n of them are worth n over this
LEAST_ERROR = 0.003

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SensedFilm:
    """A submap, in scene units, and the sensor that saw it; lens: of the working picture."""

    submap: Submap
    sensor: SensorDepth
    lens: Camera
    pinhole: Camera
    mm_per_unit: float

    def gathered(self, row: int) -> SparseDepth:
        """Points in the pinhole's picture of frame row `row`, scene units; none where too few frames have depth."""
        votes = [vote for step in STEPS if (vote := self._vote(row, row + step)) is not None]
        if len(votes) < FEWEST:
            return SparseDepth(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
        fine, columns = self._cells()
        cell, depth, error = _agreed(np.array([log for log, _ in votes]), np.array([doubt for _, doubt in votes]))
        pixels = np.column_stack([cell % columns + 0.5, cell // columns + 0.5]) * fine
        # The middle of a last cell, which the picture's border cuts, may lie beyond it.
        pixels = np.minimum(pixels, [self.pinhole.width - 0.5, self.pinhole.height - 0.5])
        chosen = one_a_cell(pixels, max(2.0, CELL * self.pinhole.width))
        return SparseDepth(pixels[chosen], depth[chosen], error[chosen])

    def _cells(self) -> tuple[int, int]:
        """Side of a cell in pixels, and how many lie in a row."""
        fine = max(FINE_PX, int(np.ceil(self.sensor.spacing_px)))
        return fine, -(-self.pinhole.width // fine)

    def _vote(self, row: int, other: int) -> tuple[Array, Array] | None:
        """Log depth and relative error of each cell of frame `row` (cells,), NaN = none, by what frame `other` saw."""
        found = None
        if 0 <= other < len(self.submap.frames):
            found = in_pinhole(self.sensor, int(self.submap.frames[other]), self.lens, self.pinhole)
        if found is None:
            return None
        fine, columns = self._cells()
        pixels, depth, sigma = found
        rays = np.column_stack([(pixels - self.pinhole.centre) / self.pinhole.focal, np.ones(len(pixels))])
        world_from_camera = self.submap.world_from_camera
        points = rays * (depth / self.mm_per_unit)[:, None]
        local: Array = in_camera(inverse(world_from_camera[row]) @ world_from_camera[other], points).astype(np.float64)
        front = local[:, 2] > 1e-6
        place = np.floor(self.pinhole.project(local[front]) / fine).astype(np.int64)
        rows = -(-self.pinhole.height // fine)
        inside = ((place >= 0) & (place < [columns, rows])).all(axis=1)
        cell = place[inside, 1] * columns + place[inside, 0]
        return _nearest_wall(cell, local[front][inside, 2], (sigma / depth)[front][inside], rows * columns)


def _nearest_wall(cell: NDArray[np.int64], depth: Array, error: Array, count: int) -> tuple[Array, Array]:
    """Means of log depth and error in each of `count` cells over the points that nothing in the cell hides."""
    nearest = np.full(count, np.inf)
    np.minimum.at(nearest, cell, depth)
    shown = depth < (1 + 2 * SAME_WALL) * nearest[cell]
    many = np.bincount(cell[shown], minlength=count)
    with np.errstate(invalid="ignore"):
        means = (np.bincount(cell[shown], of[shown], count) / many for of in (np.log(depth), error))
        log, doubt = means
    return log, doubt


def _agreed(log: Array, doubt: Array) -> tuple[NDArray[np.int64], Array, Array]:
    """Cells (K,) in which most of the frames' log depths (F,cells) agree, their depth (K,) and relative error (K,)."""
    known = np.isfinite(log).sum(axis=0)
    cell = np.flatnonzero(known >= FEWEST)
    log, doubt, known = log[:, cell], doubt[:, cell], known[cell]
    agree = np.abs(log - np.nanmedian(log, axis=0)) < SAME_WALL if len(cell) else np.zeros(log.shape, bool)
    count = agree.sum(axis=0)
    kept = (count >= FEWEST) & (count >= MAJORITY * known)
    cell, agree, count = cell[kept], agree[:, kept], count[kept]
    depth = np.exp(np.where(agree, log[:, kept], 0).sum(axis=0) / count)
    error = np.where(agree, doubt[:, kept], 0).sum(axis=0) / count / np.sqrt(count / ALIKE)
    return cell, depth, np.maximum(error, LEAST_ERROR)
