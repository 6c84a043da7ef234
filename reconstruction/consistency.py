"""Do a frame's neighbours see what its depth says? Reprojection both ways, before anything is fused.

Each pixel of a frame is carried into other frames that look at the same wall. There it either lies on the other's
surface (support), in the space that the other looks through (contradiction), or behind the other's surface: hidden, as
behind a fold, unless the frame itself looks through that surface (contradiction again). Depth that several frames
contradict is an error of one of them, most often a gross one that the sparse points or the network believed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

MIN_VOTERS = 2
MIN_SHARE_OF_VOTER = 0.1  # of the known pixels

Depth = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class DepthView:
    """A posed depth map: (H,W) z-depth, 0 = none; (3,3) intrinsics with the top-left pixel's centre at (0.5, 0.5);
    (4,4) pose. Depth and pose in one unit."""

    depth: Depth
    intrinsics: NDArray[np.float64]
    world_from_camera: NDArray[np.float64]

    @cached_property
    def extremes(self) -> tuple[Depth, Depth]:
        """Nearest and farthest known depth in each 3x3 window; 0 where a window holds an unknown one."""
        window = np.ones((3, 3), np.uint8)
        nearest = cv2.erode(self.depth, window, borderType=cv2.BORDER_REPLICATE)
        farthest = cv2.dilate(self.depth, window, borderType=cv2.BORDER_REPLICATE)
        return nearest, np.where(nearest > 0, farthest, 0)


@dataclass(frozen=True)
class Agreement:
    """How many of the other frames support and how many contradict each pixel, (H,W) each."""

    supports: NDArray[np.int16]
    contradictions: NDArray[np.int16]
    voters: int  # other frames that judged a tenth of the frame's known pixels or more

    @property
    def judged(self) -> Mask:
        return self.supports + self.contradictions > 0

    @property
    def contradicted_share(self) -> float:
        """Share of the judged pixels that more frames contradict than support; 0 if none was judged."""
        judged = self.judged
        return float((self.contradictions > self.supports)[judged].mean()) if judged.any() else 0.0

    def is_outvoted(self, share: float) -> bool:
        """Whether two or more others that see much of the frame contradict more than this share of it. One alone could
        itself be the one in error."""
        return self.voters >= MIN_VOTERS and self.contradicted_share > share

    def weight(self, severity: float = 2.0) -> Depth:
        """Factor on the confidence in (0,1]: 1 where nobody contradicts, 1 / (1 + severity) for one against none."""
        kept = 1 + self.supports.astype(np.float32)
        return (kept / (kept + np.float32(severity) * self.contradictions)).astype(np.float32)


def agreement(view: DepthView, others: Sequence[DepthView], tolerance: float, stride: int = 2) -> Agreement:
    """Votes of `others` on every `stride`-th pixel of `view`, spread to the pixels between.

    tolerance: relative difference of depth that still counts as the same surface.
    """
    rows, columns = np.arange(0, view.depth.shape[0], stride), np.arange(0, view.depth.shape[1], stride)
    depth = view.depth[np.ix_(rows, columns)]
    x, y = np.meshgrid(columns + 0.5, rows + 0.5)
    points = _in_world(view, x, y, depth)
    votes, voters = np.zeros((2, *depth.shape), np.int16), 0
    for other in others:
        support, contradiction = _judge(points, depth > 0, view, other, tolerance)
        votes += np.stack([support, contradiction])
        voters += int((support | contradiction).sum() > MIN_SHARE_OF_VOTER * (depth > 0).sum())
    height, width = view.depth.shape
    supports, contradictions = (v.repeat(stride, 0).repeat(stride, 1)[:height, :width] for v in votes)
    return Agreement(supports, contradictions, voters)


def _judge(
    points: NDArray[np.float32], known: Mask, view: DepthView, other: DepthView, tolerance: float
) -> tuple[Mask, Mask]:
    """(support, contradiction) of one other frame for world points (h,w,3)."""
    rows, columns, z, inside = _project(other, points)
    nearest, farthest = (extreme[rows, columns] for extreme in other.extremes)
    seen = known & inside & (farthest > 0) & (nearest > 0)
    # Between the nearest and farthest depth around the pixel: a fold's edge is never met to the pixel.
    through = seen & (z < nearest * (1 - tolerance))
    behind = seen & (z > farthest * (1 + tolerance))
    support = seen & ~through & ~behind
    # The surface that seems to hide the point, carried back: does this frame look through it?
    hiding = _in_world(other, columns + 0.5, rows + 0.5, other.depth[rows, columns])
    back_rows, back_columns, back_z, back_inside = _project(view, hiding)
    own_nearest = view.extremes[0][back_rows, back_columns]
    looked_through = behind & back_inside & (own_nearest > 0) & (back_z < own_nearest * (1 - tolerance))
    return support, through | looked_through


def _in_world(view: DepthView, x: NDArray[np.floating], y: NDArray[np.floating], depth: Depth) -> NDArray[np.float32]:
    """World points (...,3) of pixel positions in COLMAP's convention."""
    fx, fy, cx, cy = view.intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]]
    in_camera = np.stack([(x - cx) / fx * depth, (y - cy) / fy * depth, depth], axis=-1).astype(np.float32)
    pose = view.world_from_camera.astype(np.float32)
    return in_camera @ pose[:3, :3].T + pose[:3, 3]


def _project(view: DepthView, points: NDArray[np.float32]) -> tuple[NDArray[np.int32], NDArray[np.int32], Depth, Mask]:
    """Row and column of the pixel that each world point falls into (0 where none), its z-depth, whether it has one."""
    pose = np.linalg.inv(view.world_from_camera).astype(np.float32)
    in_camera = points @ pose[:3, :3].T + pose[:3, 3]
    z = in_camera[..., 2]
    fx, fy, cx, cy = view.intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]].astype(np.float32)
    safe = np.maximum(z, np.float32(1e-9))
    column, row = fx * in_camera[..., 0] / safe + cx, fy * in_camera[..., 1] / safe + cy
    height, width = view.depth.shape
    inside = (z > 1e-9) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    return np.where(inside, row, 0).astype(np.int32), np.where(inside, column, 0).astype(np.int32), z, inside
