"""Alignment of a small patch with its pictures in other frames along their epipolar lines.

The only unknown of a patch is a relative change s of its inverse depth; it moves the patch's picture in view v by
motion_v s. s minimises the squared difference of the normalised patches (mean 0, deviation 1, Gaussian window), so that
neither the distance of a lamp nor the gain matters: a search over some pixels first, then Gauss-Newton steps whose
derivative is taken from the reference patch alone (inverse compositional: Baker and Matthews, IJCV 2004).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.matching.patch_kernels import compare

HALF_WIDTH = 4  # px; a patch has 9x9 pixels
WINDOW_SIGMA = 2.5  # px
SEARCH_PX, SEARCH_STEP_PX = 2.0, 1.0  # either way, in the view that moves most
STEPS = 3  # of Gauss-Newton,
LARGEST_STEP_PX = 0.7  # each
LEAST_CORRELATION, FULL_CORRELATION = 0.5, 0.9  # of a view without a weight, and of one with all of it
GOOD_CORRELATION = 0.6
LEAST_VIEWS = 2  # that must correlate well, and more than half of those that there are
LEAST_AREA = 0.05  # of a patch in another view over its area here; below it the wall is seen along itself
PROBE_PX, PROBE_SHIFT = 2.0, 0.01  # by which a patch is moved to see how its picture in another view moves
# Pixels to the right and below, and s: the patch's middle, the wall beside it on two sides, and the middle moved.
PROBES = ((0, 0, 0), (PROBE_PX, 0, 0), (0, PROBE_PX, 0), (0, 0, PROBE_SHIFT))
LEAST_CONTRAST = 0.5  # grey levels, below which a patch is flat
PER_SIGMA, PER_SIGMA_CONTRAST, LEAST_ERROR = 1.6, 43.0, 0.0037  # of the expected error: `expected_error`

Floats = NDArray[np.float32]
Array = NDArray[np.float64]


def patch_offsets() -> Floats:
    """(K,2) pixels of a patch from its centre, x and y."""
    along = np.arange(-HALF_WIDTH, HALF_WIDTH + 1, dtype=np.float32)
    x, y = np.meshgrid(along, along)
    return np.stack([x.ravel(), y.ravel()], axis=1)


OFFSETS = patch_offsets()
WINDOW = np.exp(-(OFFSETS.astype(np.float64) ** 2).sum(axis=1) / (2 * WINDOW_SIGMA**2))
WINDOW = (WINDOW / WINDOW.sum()).astype(np.float32)  # (K,)
INDEPENDENT_PIXELS = 1 / float(WINDOW @ WINDOW)  # of a patch, as the window weighs them


@dataclass(frozen=True)
class ReferencePatches:
    """(P,K) grey values of the patches where they are defined, and their derivatives by x and y."""

    grey: Floats
    by_x: Floats
    by_y: Floats


@dataclass(frozen=True)
class PatchViews:
    """(V,) pictures of patches, sorted by frame: number of the patch and of the frame, pixel of the patch's centre
    (V,2) in COLMAP's convention, shape (V,2,2) = d pixel / d offset, motion (V,2) = d pixel / d s."""

    patch: NDArray[np.int64]
    frame: NDArray[np.int64]
    centre: Array
    shape: Array
    motion: Array


@dataclass(frozen=True)
class Alignment:
    """(P,) of each patch: s, its standard deviation as the residuals have it (no systematic error), number of views,
    of those that correlate by more than `GOOD_CORRELATION`, and contrast: deviation over mean grey value."""

    shift: Array
    sigma: Array
    views: NDArray[np.int64]
    correlating: NDArray[np.int64]
    contrast: Array

    @property
    def confirmed(self) -> NDArray[np.bool_]:
        """(P,) whether enough views show the patch, and most of those that are asked."""
        return (self.correlating >= LEAST_VIEWS) & (2 * self.correlating > self.views)


def read_patches(grey: NDArray[np.uint8], pixels: Array) -> ReferencePatches:
    """Upright patches of a picture about pixels (P,2)."""
    picture, at = grey.astype(np.float32), (pixels[:, None] + OFFSETS).astype(np.float32)
    slope = [cv2.Sobel(picture, cv2.CV_32F, x, 1 - x, scale=1 / 8) for x in (1, 0)]
    return ReferencePatches(*(_sampled(image, at) for image in (picture, *slope)))


def align_patches(
    reference: ReferencePatches, views: PatchViews, pictures: Mapping[int, NDArray[np.uint8]]
) -> Alignment:
    """pictures: grey, of all frames of `views`."""
    problem = _Problem(reference, views, pictures)
    shift = problem.searched()
    for _ in range(STEPS):
        shift = problem.stepped(shift)
    return problem.judged(shift)


def pictured(pixels: Array) -> tuple[Array, Array, Array]:
    """Centre (N,2), shape (N,2,2) and motion (N,2) of `PatchViews`: pixels (N,4,2) where a view shows `PROBES`."""
    centre = pixels[:, 0]
    shape = np.stack([pixels[:, 1] - centre, pixels[:, 2] - centre], axis=2) / PROBE_PX
    return centre, shape, (pixels[:, 3] - centre) / PROBE_SHIFT


def expected_error(aligned: Alignment) -> Array:
    """(P,) relative error of depth, 1 sigma. The residuals alone say too little of it: what a patch has wrong, its
    slope or an edge in it, is wrong in all views alike. Fitted by maximum likelihood (Student's t of two degrees) to
    points of features on films kept for choosing (docs/lab/points.md)."""
    return np.hypot(aligned.sigma * np.hypot(PER_SIGMA, PER_SIGMA_CONTRAST * aligned.contrast), LEAST_ERROR)


def groups(numbers: NDArray[np.integer[Any]]) -> Iterator[tuple[int, slice]]:
    """Each number of the sorted (N,), none of which is negative, and where it stands."""
    starts = np.flatnonzero(np.diff(numbers, prepend=-1))
    for first, last in pairwise([*starts.tolist(), len(numbers)]):
        yield int(numbers[first]), slice(first, last)


def _sampled(picture: Floats, pixels: Floats) -> Floats:
    """(N,K) of a picture at pixels (N,K,2)."""
    at = pixels - np.float32(0.5)  # OpenCV's pixel centres are whole
    found = cv2.remap(picture, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, np.float32)


def _normalised(patches: Floats) -> tuple[Floats, Floats]:
    """(N,K) with mean 0 and deviation 1 under the window, and the deviation (N,) before."""
    centred = patches - (patches @ WINDOW)[:, None]
    deviation = np.sqrt((centred * centred) @ WINDOW)
    return centred / np.maximum(deviation, np.float32(LEAST_CONTRAST))[:, None], deviation


@dataclass(frozen=True)
class _Seen:
    """(V,) of each view: its correlation with the reference, its weight, the difference times the reference's
    derivatives by x and y (V,2), and its square."""

    correlation: Array
    weight: Array
    across: Array
    squared: Array


class _Problem:
    """Normalised reference patches, their derivatives by s in each view, and the views that they are compared with."""

    def __init__(
        self, reference: ReferencePatches, views: PatchViews, pictures: Mapping[int, NDArray[np.uint8]]
    ) -> None:
        self.views, self.pictures, self.count = views, pictures, len(reference.grey)
        self.patch, deviation = _normalised(reference.grey)
        self.contrast = (deviation / np.maximum(reference.grey @ WINDOW, 1)).astype(np.float64)
        scale: Floats = np.maximum(deviation, np.float32(LEAST_CONTRAST))[:, None]
        self.by_x, self.by_y = (self._without_gain(d / scale) for d in (reference.by_x, reference.by_y))
        # A change of s moves what view v shows by this many pixels of the reference patch.
        self.along = np.linalg.solve(views.shape, views.motion[:, :, None])[:, :, 0]
        products = (self.by_x * self.by_x, self.by_x * self.by_y, self.by_y * self.by_y)
        xx, xy, yy = ((product @ WINDOW)[views.patch] for product in products)
        x, y = self.along.T
        self.information = x * x * xx + 2 * x * y * xy + y * y * yy
        fastest = np.zeros(self.count)
        np.maximum.at(fastest, views.patch, np.linalg.norm(views.motion, axis=1))
        self.per_px = np.where(fastest > 0, 1 / np.maximum(fastest, 1e-9), 0)  # change of s that moves by a pixel

    def _without_gain(self, derivative: Floats) -> Floats:
        """Of the normalised patch: what changes neither its mean nor its deviation."""
        centred = derivative - (derivative @ WINDOW)[:, None]
        return np.asarray(centred - ((centred * self.patch) @ WINDOW)[:, None] * self.patch, np.float32)

    def summed(self, values: Array) -> Array:
        """(P,) sums over the views of each patch."""
        return np.asarray(np.bincount(self.views.patch, values, minlength=self.count), np.float64)

    def seen(self, shift: Array) -> _Seen:
        """What the views show with s = shift (P,), compared with the reference patches."""
        views, found = self.views, np.empty((len(self.views.patch), 4))
        centre = views.centre + views.motion * shift[views.patch][:, None]
        reference = self.patch, self.by_x, self.by_y
        for frame, mine in groups(views.frame):
            here = centre[mine], views.shape[mine], OFFSETS, WINDOW, views.patch[mine]
            compare(self.pictures[frame], *here, *reference, LEAST_CONTRAST, found[mine])
        weight = (found[:, 0] - LEAST_CORRELATION) / (FULL_CORRELATION - LEAST_CORRELATION)
        return _Seen(found[:, 0], np.clip(weight, 0, 1), found[:, 1:3], found[:, 3])

    def searched(self) -> Array:
        """(P,) the s of the greatest correlation, in whole steps."""
        best, chosen = np.full(self.count, -1.0), np.zeros(self.count)
        steps = np.arange(-SEARCH_PX, SEARCH_PX + SEARCH_STEP_PX / 2, SEARCH_STEP_PX)
        for moved in steps[np.argsort(np.abs(steps), kind="stable")]:  # none, where all are as good
            total = self.summed(np.clip(self.seen(moved * self.per_px).correlation, 0, 1))
            better = total > best
            best[better], chosen[better] = total[better], moved
        return chosen * self.per_px

    def stepped(self, shift: Array) -> Array:
        """One Gauss-Newton step, of `LARGEST_STEP_PX` at most."""
        seen = self.seen(shift)
        slope = self.summed(seen.weight * (self.along * seen.across).sum(axis=1))
        information = self.summed(seen.weight * self.information)
        largest = LARGEST_STEP_PX * self.per_px
        return shift - np.clip(slope / np.maximum(information, 1e-12), -largest, largest)

    def judged(self, shift: Array) -> Alignment:
        """How well the patches fit, and what the residuals say of the uncertainty of s."""
        seen = self.seen(shift)
        total = np.maximum(self.summed(seen.weight), 1e-9)
        variance = self.summed(seen.weight * seen.squared) / total
        information = INDEPENDENT_PIXELS * self.summed(seen.weight * self.information)
        sigma = np.sqrt(variance / np.maximum(information, 1e-12))
        return Alignment(
            shift,
            sigma,
            np.bincount(self.views.patch, minlength=self.count),
            np.bincount(self.views.patch[seen.correlation > GOOD_CORRELATION], minlength=self.count),
            self.contrast,
        )
