"""Depth of points on a grid of a keyframe, where patches of its picture fit those of keyframes around it.

Corners and features are few where the wall is smooth. A keyframe's completed depth says where each patch of it must
show in a neighbour, to a pixel or two, and how it is tilted; there the patch is moved along its ray to where it fits
best (`pipeline.matching.patch_alignment`). A single patch of smooth wall is often farther off than the completed depth
at its place; many together say by how much that depth is off around them. So they are points for `towards_points`, not
depth.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.depth.sparse_depth import SparseDepth
from pipeline.matching.patch_alignment import (
    HALF_WIDTH,
    LEAST_AREA,
    PROBES,
    SEARCH_PX,
    PatchViews,
    align_patches,
    expected_error,
    pictured,
    read_patches,
)

CELL = 1 / 40  # of the longer side, from point to point: 8 px of 320
MOST_ERROR = 0.1  # expected, of a depth that is taken,
MOST_SHIFT = 0.1  # and its relative change of inverse depth
SAME_WALL = 0.15  # by which a point's depth in another view may differ from that view's own, relative to it
SLOPE_SIGMA = 2.0  # px, of the Gaussian over which the wall's slope is taken
LEAST_DEPTH = 1e-6  # scene units before a camera

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class View:
    """A keyframe: grey (H,W); clearance (H,W) px to the nearest pixel that is masked or without depth, or beyond the
    border; depth (H,W) scene units, 0 = none; world_from_camera (4,4)."""

    grey: Picture
    clearance: Image
    depth: Image
    world_from_camera: Array


def view_of(rgb: Picture, mask: Picture, depth: Image, world_from_camera: Array) -> View:
    """Of a rectified keyframe: rgb (H,W,3), mask (H,W), 0 at the border and on highlights, and its depth."""
    known = np.pad(((mask > 0) & (depth > 0)).astype(np.uint8), 1)
    clearance = cv2.distanceTransform(known, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    return View(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), clearance, depth, world_from_camera)


def photometric_points(view: View, others: Sequence[View], intrinsics: Array) -> SparseDepth:
    """Points of `view` whose depth its neighbours' pictures confirm, with their expected relative errors.

    intrinsics (3,3) of all views, COLMAP's convention. Poses are held fixed. Errors are fitted to points of
    features, and too small for these (docs/lab/photometric.md).
    """
    pixels = _grid(view)
    inverse_depth, slopes = _wall(view.depth, pixels)
    world = _probes(view, pixels, inverse_depth, slopes, intrinsics)
    found = [_seen_in(other, world, intrinsics) for other in others]
    if not len(pixels) or not sum(len(shown.patch) for shown in found):
        return SparseDepth(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    views = _joined(found)
    aligned = align_patches(read_patches(view.grey, pixels), views, {k: o.grey for k, o in enumerate(others)})
    error = expected_error(aligned)
    good = aligned.confirmed & (np.abs(aligned.shift) < MOST_SHIFT) & (error < MOST_ERROR)
    return SparseDepth(pixels[good], 1 / (inverse_depth * (1 + aligned.shift))[good], error[good])


def _grid(view: View) -> Array:
    """(P,2) pixel centres a cell apart, where a patch shows wall alone."""
    height, width = view.depth.shape
    step = max(2, round(CELL * max(height, width)))
    y, x = (index.ravel() for index in np.mgrid[step // 2 : height : step, step // 2 : width : step])
    clear = view.clearance[y, x] >= _reach(1.0)
    return np.column_stack([x[clear], y[clear]]) + 0.5


def _reach(scale: ArrayLike) -> Array:
    """px from its middle that a patch shows where it is looked for, magnified by `scale`. Its corners reach farther,
    and weigh less than a tenth of the middle."""
    return np.asarray(HALF_WIDTH * np.asarray(scale) + SEARCH_PX)


def _wall(depth: Image, pixels: Array) -> tuple[Array, Array]:
    """(P,) inverse depth at pixels, and (P,2) its change a pixel across and down, over what is around."""
    known = (depth > 0).astype(np.float32)
    inverse = np.divide(known, depth, out=np.zeros_like(depth), where=depth > 0)
    mean, share = (cv2.GaussianBlur(image, (0, 0), SLOPE_SIGMA) for image in (inverse, known))
    smooth = mean / np.maximum(share, 1e-6)
    x, y = np.floor(pixels).astype(int).T
    slopes = [cv2.Sobel(smooth, cv2.CV_32F, axis, 1 - axis, scale=1 / 8)[y, x] for axis in (1, 0)]
    return inverse[y, x].astype(np.float64), np.column_stack(slopes).astype(np.float64)


def _probes(view: View, pixels: Array, inverse_depth: Array, slopes: Array, intrinsics: Array) -> Array:
    """(P,4,3) `PROBES` in the world."""
    probes = np.zeros((len(pixels), 4, 3))
    for number, (x, y, shift) in enumerate(PROBES):
        plane = (pixels + np.array([x, y]) - intrinsics[:2, 2]) / intrinsics[[0, 1], [0, 1]]
        there = np.clip(inverse_depth + slopes @ np.array([x, y]), 0.5 * inverse_depth, 2 * inverse_depth)
        probes[:, number] = np.column_stack([plane, np.ones(len(plane))]) / (there * (1 + shift))[:, None]
    pose = view.world_from_camera
    return np.asarray(probes @ pose[:3, :3].T + pose[:3, 3])


def _seen_in(other: View, world: Array, intrinsics: Array) -> PatchViews:
    """Pictures of patches in another view (its number is still 0), where it shows them clear of what is masked, and on
    the wall that it has."""
    pose = other.world_from_camera
    local = (world - pose[:3, 3]) @ pose[:3, :3]
    before: NDArray[np.bool_] = np.asarray((local[..., 2] > LEAST_DEPTH).all(axis=1))
    depth = np.where(before[:, None], local[..., 2], 1.0)
    pixels = local[..., :2] / depth[..., None] * intrinsics[[0, 1], [0, 1]] + intrinsics[:2, 2]
    centre, shape, motion = pictured(pixels)
    height, width = other.depth.shape
    within: NDArray[np.bool_] = before & (centre >= 0).all(axis=1) & (centre < [width, height]).all(axis=1)
    x, y = np.clip(np.floor(np.where(within[:, None], centre, 0)), 0, [width - 1, height - 1]).astype(int).T
    clear = other.clearance[y, x] >= _reach(np.linalg.norm(shape, 2, axis=(1, 2)))
    own = np.where(clear, other.depth[y, x], np.inf)  # where it is clear, there is depth
    same_wall = np.abs(depth[:, 0] / own - 1) < SAME_WALL
    shown = within & same_wall & (np.linalg.det(shape) > LEAST_AREA)
    patch = np.flatnonzero(shown)
    return PatchViews(patch, np.zeros(len(patch), np.int64), centre[patch], shape[patch], motion[patch])


def _joined(found: Sequence[PatchViews]) -> PatchViews:
    frame = np.concatenate([np.full(len(shown.patch), number) for number, shown in enumerate(found)])
    patch, centre, shape, motion = (
        np.concatenate([getattr(shown, name) for shown in found]) for name in ("patch", "centre", "shape", "motion")
    )
    return PatchViews(patch, frame, centre, shape, motion)
