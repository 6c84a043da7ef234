"""A depth map carried to the wall at another time: every point that it saw is moved, and seen again from its camera.

The moved points lie at other pixels than those that saw them. Which pixel's point now lies at a pixel is found by
fixed-point iteration on the flow of the pixels, as backward warping of pictures does; where it does not settle, as
beside a fold's edge, the depth is left out. Nothing is filled.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Depth = NDArray[np.float32]
ITERATIONS = 8
SETTLED_PX = 0.5  # that the found point may lie beside its pixel
EDGE = 0.05  # relative difference to the nearest pixel's depth beyond which bilinear depth mixes two walls


@dataclass(frozen=True)
class CarriedDepth:
    """depth (H,W) z-depth of the moved wall, 0 = none. source (H,W,2): pixel (x, y) that saw it, OpenCV's
    integer-centre pixels; -1 where depth is 0."""

    depth: Depth
    source: NDArray[np.float32]

    def image(self, values: NDArray) -> NDArray:
        """A picture (H,W,C) or map (H,W) of the frame, carried along with its depth; 0 where there is none."""
        return cv2.remap(values, self.source, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)


def points_of(depth: Depth, intrinsics: Array) -> NDArray[np.float32]:
    """Points (H,W,3) in camera axes of z-depth (H,W); intrinsics (3,3) with the first pixel's centre at (0.5, 0.5)."""
    fx, fy, cx, cy = intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]].astype(np.float32)
    rows, columns = np.indices(depth.shape, dtype=np.float32)
    return np.stack([(columns + 0.5 - cx) / fx * depth, (rows + 0.5 - cy) / fy * depth, depth], axis=-1)


def carried(depth: Depth, offsets: NDArray[np.float32], intrinsics: Array) -> CarriedDepth:
    """Depth (H,W) whose points move by offsets (H,W,3), in camera axes and the depth's unit."""
    fx, fy, cx, cy = intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]].astype(np.float32)
    moved = points_of(depth, intrinsics) + offsets
    rows, columns = np.indices(depth.shape, dtype=np.float32)
    known = (depth > 0) & (moved[..., 2] > 1e-6)
    z = np.where(known, moved[..., 2], np.float32(1))
    flow = np.stack([moved[..., 0] / z * fx + cx - 0.5 - columns, moved[..., 1] / z * fy + cy - 0.5 - rows], axis=-1)
    flow[~known] = 0
    here = np.stack([columns, rows], axis=-1)
    source = here.copy()
    for _ in range(ITERATIONS):
        source = here - _at(flow, source)
    off = np.linalg.norm(source + _at(flow, source) - here, axis=-1)
    z = np.where(known, z, np.float32(0))
    between, nearest = _at(z, source), cv2.remap(z, source, None, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
    whole = _at(known.astype(np.float32), source) > 0.999
    good = whole & (off < SETTLED_PX) & (np.abs(between - nearest) <= EDGE * nearest)
    return CarriedDepth(np.where(good, between, np.float32(0)), np.where(good[..., None], source, np.float32(-1)))


def _at(values: NDArray[np.float32], source: NDArray[np.float32]) -> NDArray[np.float32]:
    """Values (H,W[,C]) at pixels (H,W,2), bilinear."""
    return cv2.remap(values, source, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
