"""Which keyframe of the page shows the direction of a missed region, and where in its picture."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera

FARTHER = 1.5  # times as far from the place as the keyframe nearest in time is: hardly a worse look at it
INNER = 0.8  # share of the picture, across and down, in which a place is well inside

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RegionMark:
    """row: of the views that were asked for. at: shares of the picture's width and height, from its upper left corner;
    None where the place is in none of the pictures."""

    row: int
    at: tuple[float, float] | None


def mark_region(
    place: Array, frame: int, world_from_camera: Array, frames: NDArray[np.int64], camera: Camera
) -> RegionMark:
    """Of views (N,4,4) of frames (N,), N > 0, the one nearest in time to `frame` that has `place` (3,) in its picture,
    or one about as near to the place with it well inside; where no picture has it, the nearest in time.

    camera: of the pictures. The wall may hide the place there.
    """
    offset = np.einsum("nji,nj->ni", world_from_camera[:, :3, :3], place - world_from_camera[:, :3, 3])
    ahead = offset[:, 2] > 0
    at = np.full((len(offset), 2), np.inf)
    at[ahead] = camera.project(offset[ahead]) / (camera.width, camera.height)
    off_middle = np.abs(2 * at - 1).max(axis=1)
    seen = off_middle <= 1
    away, distance = np.abs(frames - frame), np.linalg.norm(offset, axis=1)
    if not seen.any():
        return RegionMark(int(np.argmin(away)), None)
    nearest = int(np.argmin(np.where(seen, away, np.inf)))
    near = seen & (distance <= FARTHER * distance[nearest])
    inside = near & (off_middle <= INNER)
    row = int(np.argmin(np.where(inside, away, np.inf))) if inside.any() else nearest
    return RegionMark(row, (float(at[row, 0]), float(at[row, 1])))
