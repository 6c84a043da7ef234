"""Depth consistency: support and contradiction of a depth map by its neighbours, by reprojection both ways.

Each pixel of a frame is reprojected into other frames that look at the same wall. There it either lies on the other's
surface (support), in the space that the other looks through (contradiction), or behind the other's surface: occluded,
as behind a fold, unless the frame itself looks through that surface (contradiction again). Depth that several frames
contradict is an error of one of them, most often an outlier of the sparse points or of the network.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.numba_cache import compiled

MIN_VOTERS = 2  # frames that must judge a frame before it can be outvoted
MIN_SHARE_OF_VOTER = 0.1  # share of a frame's known pixels that another must judge to count as a voter
MIN_Z = 1e-9  # below which a point lies behind the camera

Depth = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class DepthView:
    """A posed depth map; depth and translation in one unit."""

    depth: Depth  # (H,W) z-depth, 0 = none
    intrinsics: NDArray[np.float64]  # (3,3), the top-left pixel's centre at (0.5, 0.5)
    world_from_camera: NDArray[np.float64]  # (4,4)

    @cached_property
    def extremes(self) -> tuple[Depth, Depth]:
        """Least and greatest depth (H,W) in each 3x3 window; 0 where a window holds an unknown one."""
        window = np.ones((3, 3), np.uint8)
        nearest = cv2.erode(self.depth, window, borderType=cv2.BORDER_REPLICATE)
        farthest = cv2.dilate(self.depth, window, borderType=cv2.BORDER_REPLICATE)
        return nearest, np.where(nearest > 0, farthest, 0)


@dataclass(frozen=True)
class Agreement:
    """Votes of other frames on the pixels of one."""

    supports: NDArray[np.int16]  # (H,W) frames that support the pixel
    contradictions: NDArray[np.int16]  # (H,W) frames that contradict it
    voters: int  # other frames that judged MIN_SHARE_OF_VOTER of the known pixels or more

    @property
    def judged(self) -> Mask:
        """(H,W) pixels with any vote."""
        return self.supports + self.contradictions > 0

    @property
    def contradicted_share(self) -> float:
        """Share of the judged pixels that more frames contradict than support; 0 if none was judged."""
        judged = self.judged
        return float((self.contradictions > self.supports)[judged].mean()) if judged.any() else 0.0

    def is_outvoted(self, share: float) -> bool:
        """Whether more than `share` of the judged pixels are contradicted, by MIN_VOTERS frames or more.

        A single voter could itself be the one in error.
        """
        return self.voters >= MIN_VOTERS and self.contradicted_share > share

    def confidence_factor(self, severity: float) -> Depth:
        """(H,W) in (0,1]: 1 without contradiction, 1 / (1 + severity) for one contradiction without any support."""
        supported = 1 + self.supports.astype(np.float32)
        return (supported / (supported + np.float32(severity) * self.contradictions)).astype(np.float32)


def agreement(view: DepthView, others: Sequence[DepthView], tolerance: float, stride: int = 2) -> Agreement:
    """Votes of `others` on every `stride`-th pixel of `view`, repeated for the pixels between.

    tolerance: relative difference of depth up to which two depths are of the same surface.
    """
    height, width = view.depth.shape
    votes, voters = np.zeros((2, -(-height // stride), -(-width // stride)), np.int16), 0
    known = int(np.count_nonzero(view.depth[::stride, ::stride] > 0))
    for other in others:
        other_from_view = np.linalg.inv(other.world_from_camera) @ view.world_from_camera
        both_ways = other_from_view, np.linalg.inv(other_from_view)
        judged = _vote(*_arrays(view), *_arrays(other), *both_ways, tolerance, stride, votes)
        voters += int(judged > MIN_SHARE_OF_VOTER * known)
    supports, contradictions = (v.repeat(stride, 0).repeat(stride, 1)[:height, :width] for v in votes)
    return Agreement(supports, contradictions, voters)


def _arrays(view: DepthView) -> tuple[Depth, Depth, Depth, NDArray[np.float64]]:
    """A view as `_vote` takes it: depth, its extremes (H,W), and fx, fy, cx, cy (4,)."""
    nearest, farthest = view.extremes
    pinhole: NDArray[np.float64] = np.asarray(view.intrinsics, np.float64)[[0, 1, 0, 1], [0, 1, 2, 2]]
    return np.ascontiguousarray(view.depth, np.float32), nearest, farthest, pinhole


@compiled
def _vote(
    depth: Depth,
    nearest: Depth,
    farthest: Depth,
    pinhole: NDArray[np.float64],
    other_depth: Depth,
    other_nearest: Depth,
    other_farthest: Depth,
    other_pinhole: NDArray[np.float64],
    other_from_view: NDArray[np.floating],
    view_from_other: NDArray[np.floating],
    tolerance: float,
    stride: int,
    votes: NDArray[np.int16],
) -> int:
    """Add one other frame's supports and contradictions to `votes` (2,h,w); returns how many pixels it judged."""
    judged = 0
    for row in range(0, depth.shape[0], stride):
        for column in range(0, depth.shape[1], stride):
            if not depth[row, column] > 0:
                continue
            z, i, j = _reprojected(
                row, column, depth[row, column], pinhole, other_from_view, other_pinhole, other_depth.shape
            )
            # Between the least and greatest depth around the pixel: a fold's edge is never met to the pixel.
            if i < 0 or not other_nearest[i, j] > 0:
                continue
            if z < other_nearest[i, j] * (1 - tolerance):
                votes[1, row // stride, column // stride] += 1
            elif z <= other_farthest[i, j] * (1 + tolerance):
                votes[0, row // stride, column // stride] += 1
            else:  # behind the other's surface: does this frame look through that?
                back, k, m = _reprojected(i, j, other_depth[i, j], other_pinhole, view_from_other, pinhole, depth.shape)
                if k < 0 or not nearest[k, m] > 0 or back >= nearest[k, m] * (1 - tolerance):
                    continue
                votes[1, row // stride, column // stride] += 1
            judged += 1
    return judged


@compiled
def _reprojected(
    row: int,
    column: int,
    depth: float,
    pinhole: NDArray[np.float64],
    to_from_here: NDArray[np.floating],
    to_pinhole: NDArray[np.float64],
    shape: tuple[int, int],
) -> tuple[float, int, int]:
    """z-depth, row and column in another frame of a pixel's centre at `depth`; row -1 if behind it or out of view."""
    x = (column + 0.5 - pinhole[2]) / pinhole[0] * depth
    y = (row + 0.5 - pinhole[3]) / pinhole[1] * depth
    a, b, c = to_from_here[0], to_from_here[1], to_from_here[2]
    z = c[0] * x + c[1] * y + c[2] * depth + c[3]
    if not z > MIN_Z:
        return z, -1, -1
    u = to_pinhole[0] * (a[0] * x + a[1] * y + a[2] * depth + a[3]) / z + to_pinhole[2]
    v = to_pinhole[1] * (b[0] * x + b[1] * y + b[2] * depth + b[3]) / z + to_pinhole[3]
    if not (u >= 0 and u < shape[1] and v >= 0 and v < shape[0]):
        return z, -1, -1
    return z, int(v), int(u)
