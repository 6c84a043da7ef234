"""Sparse depth of one keyframe from a submap's points, each with its expected relative error.

A point's depth error follows from its parallax: n rays at angles alpha_i, each off by sigma_pixel / f, fix the depth to
sigma_z / z = sigma_pixel / (f sqrt(sum (alpha_i - mean)^2)), the slope of a line fitted to them.

That holds for features, which each frame detects for itself, so that their pixel errors are independent. A corner that
KLT tracks from frame to frame drifts ("slides"), and what it is off in one frame it is off in the next: the error does
not average out. Features are preferred.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from haustra.core.camera import Camera
from pipeline.mapping.submap import Submap

MAX_REPROJECTION_PX = 1.5  # at working size, mean over the track
MIN_TRACK_LENGTH = 3  # frames that saw a point
MIN_ANGLE_DEG = 1.0  # between a point's rays; below it a pixel of error is a tenth of the depth
PIXEL_NOISE = 0.5  # px; SIFT's localisation error on mucosa
FRAMES_AROUND = 4  # on each side, whose points are projected too
OUTLIER_RATIO = 0.25  # log-depth difference to the neighbours' median
NEIGHBOURS = 8  # points whose median log depth a point is compared with
OCCLUSION_RADIUS = 0.03  # share of the width; a much nearer point this close may hide one behind it
SLIDE = 0.005  # of the width: how far a KLT corner slides along its track; measured, see docs/lab/front_end.md
REPLACED_BY, REPLACED_WITHIN = 3, 0.1  # features so near (share of the width) replace a KLT corner
KNN = 12  # nearest features among which those are looked for
SAME_WALL = 0.25  # log depth within which points are taken to lie on one wall


@dataclass(frozen=True)
class SparseDepth:
    """pixels (K,2) in the pinhole image, COLMAP's convention; depth (K,) z-depth; error (K,) relative, 1 sigma."""

    pixels: NDArray[np.float64]
    depth: NDArray[np.float64]
    error: NDArray[np.float64]

    def scaled(self, factor: float) -> "SparseDepth":
        """The same points in another unit; relative errors stay."""
        return SparseDepth(self.pixels, self.depth * factor, self.error)

    def maps(self, height: int, width: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(H,W) depth and relative error, 0 = none; where points share a pixel the surer one stays."""
        depth, error = np.zeros((2, height, width), dtype=np.float32)
        order = np.argsort(-self.error, kind="stable")
        x, y = np.floor(self.pixels[order]).astype(int).T
        depth[y, x] = self.depth[order]
        error[y, x] = self.error[order]
        return depth, error


def reliable_points(
    submap: Submap, angles: NDArray[np.float64], focal: float, pixel_noise: float = PIXEL_NOISE
) -> tuple[NDArray, NDArray]:
    """(P,) boolean mask of points that pass the filters, and (P,) relative depth error (1 sigma) of each point as if it
    were a feature.

    angles: (P,) the submap's triangulation angles, deg. focal: of the image in which the points were seen, px.
    pixel_noise: least error of an observation, px.
    """
    lengths = submap.track_lengths()
    good = (submap.error_px <= MAX_REPROJECTION_PX) & (lengths >= MIN_TRACK_LENGTH) & (angles >= MIN_ANGLE_DEG)
    noise = np.maximum(pixel_noise, submap.error_px)
    return good, noise / (focal * np.maximum(submap.ray_spreads(), 1e-6))


def error_with_slide(
    scatter: NDArray[np.float64], klt: NDArray[np.bool_], angles: NDArray[np.float64], slide: float
) -> NDArray[np.float64]:
    """(P,) relative depth error (1 sigma) of all points: `scatter` (P,), to which KLT corners, `klt` (P,), add their
    slide. angles: (P,) triangulation angles, deg. slide: px over the focal length.

    However many frames saw it on the way, a corner that slid by s px over an angle alpha is off by s / (f alpha).
    """
    return np.where(klt, np.hypot(scatter, slide / np.maximum(np.radians(angles), 1e-6)), scatter)


class SparseDepthMaker:
    """Sparse depth of any frame of a submap; filters and errors are computed once."""

    def __init__(self, submap: Submap, pinhole: Camera) -> None:
        self.submap, self.pinhole = submap, pinhole
        # The working frames' focal length, first of the parameters: reprojection errors are in their pixels.
        focal, angles = submap.camera_params[0], submap.triangulation_angles()
        self.good, self.scatter = reliable_points(submap, angles, focal)
        expected = error_with_slide(self.scatter, submap.is_klt, angles, SLIDE * pinhole.width / focal)
        refined = np.isfinite(submap.known_depth_error)  # by its patches, which do not slide
        self.error = np.where(refined, submap.known_depth_error, expected)
        order, self._starts = submap.by_frame()
        self._points = submap.observations[order, 1]

    def seen_by(self, row: int) -> NDArray[np.int64]:
        """Rows of the good points that frame row `row` observed."""
        points = self._points[self._starts[row] : self._starts[row + 1]]
        return points[self.good[points]]

    def sparse_depth(self, row: int) -> SparseDepth:
        """Points seen by frame row `row`, then those that only its neighbours saw and that nothing hides here; KLT
        corners only where few features are."""
        own = self.seen_by(row)
        reach = FRAMES_AROUND
        around = range(max(0, row - reach), min(len(self.submap.frames), row + reach + 1))
        near = np.unique(np.concatenate([self.seen_by(other) for other in around]))
        others = np.setdiff1d(near, own)
        points = np.concatenate([own, others])
        in_camera = self.submap.points_in_camera(row, self.submap.points[points])
        front = in_camera[:, 2] > 1e-6
        pixels = np.full((len(points), 2), -1.0)
        pixels[front] = self.pinhole.project(in_camera[front])
        size = np.array([self.pinhole.width, self.pinhole.height])
        keep = front & (pixels >= 0).all(axis=1) & (pixels < size).all(axis=1)
        keep[keep] = self._is_visible(pixels[keep], in_camera[keep, 2], np.flatnonzero(keep) < len(own))
        pixels, depth, error = pixels[keep], in_camera[keep, 2], self.error[points[keep]]
        kept = ~has_better_neighbours(pixels, depth, error, self.submap.is_klt[points[keep]], self.pinhole.width)
        pixels, depth, error = pixels[kept], depth[kept], error[kept]
        inlier = ~is_outlier(pixels, depth, OUTLIER_RATIO)
        return SparseDepth(pixels[inlier], depth[inlier], error[inlier])

    def _is_visible(self, pixels: NDArray, depth: NDArray, own: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """True for the frame's own points, and for others unless an own point close by is clearly nearer."""
        if not own.any() or own.all():
            return np.ones(len(pixels), dtype=bool)
        tree = cKDTree(pixels[own])
        distance, nearest = tree.query(pixels, k=min(4, int(own.sum())))
        distance, nearest = distance.reshape(len(pixels), -1), nearest.reshape(len(pixels), -1)
        close = distance < OCCLUSION_RADIUS * self.pinhole.width
        nearer = np.where(close, depth[own][nearest], np.inf).min(axis=1)
        return own | (depth < 1.1 * nearer)


def has_better_neighbours(
    pixels: NDArray[np.float64],
    depth: NDArray[np.float64],
    error: NDArray[np.float64],
    klt: NDArray[np.bool_],
    width: int,
) -> NDArray[np.bool_]:
    """(K,) True for KLT corners near which enough features, that are surer, give the depth of the same wall.

    pixels (K,2), depth (K,), relative error (K,), klt (K,) of one frame's points; width: of the image, px.
    """
    replaced = np.zeros(len(pixels), dtype=bool)
    if not klt.any() or (~klt).sum() < REPLACED_BY:
        return replaced
    count = min(KNN, int((~klt).sum()))
    distance, nearest = cKDTree(pixels[~klt]).query(pixels[klt], k=count)
    surer = error[~klt][nearest] < error[klt][:, None]
    same = np.abs(np.log(depth[~klt][nearest] / depth[klt][:, None])) < SAME_WALL
    replaced[klt] = (surer & same & (distance < REPLACED_WITHIN * width)).sum(axis=1) >= REPLACED_BY
    return replaced


def is_outlier(pixels: NDArray[np.float64], depth: NDArray[np.float64], ratio: float) -> NDArray[np.bool_]:
    """(K,) points whose log depth is farther than `ratio` plus three of its neighbours' robust standard deviations from
    their median: these differ at a fold's edge, whose points are then no outliers. pixels (K,2), depth (K,)."""
    if len(pixels) <= NEIGHBOURS:
        return np.zeros(len(pixels), dtype=bool)
    _, nearest = cKDTree(pixels).query(pixels, k=NEIGHBOURS + 1)
    log_depth = np.log(depth)
    neighbours = log_depth[nearest[:, 1:]]
    median = np.median(neighbours, axis=1)
    sigma = 1.4826 * np.median(np.abs(neighbours - median[:, None]), axis=1)
    return np.abs(log_depth - median) > ratio + 3 * sigma
