"""Places: keyframes' SIFT features with their points in the map, and which of two maps' places look alike.

The tracker's corners sit wherever a cell of its grid was empty, so a second visit finds others. SIFT finds the same
ones again. Their depth is interpolated from the map's points around them: a few percent off, which two views of one
place forgive, and far more of them get one than by matching neighbours.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay, QhullError

from haustra.core.se3 import Array
from pipeline.matching.place_recognition import vlad

FEATURES = 1000
CONTRAST = 0.002  # a twentieth of OpenCV's: pale mucosa has little more
RATIO = 0.85  # best over second-best distance
MIN_POINTS = 25  # of a place worth remembering
STILL_PX = 1.0  # what moves by less from picture to picture may be dirt or text
WORDS = 32
SAMPLE = 20_000


@dataclass(frozen=True)
class Features:
    """pixels (N,2), COLMAP's convention; descriptors (N,128) as SIFT gives them; sizes (N,), pixels across."""

    pixels: Array
    descriptors: NDArray[np.uint8]
    sizes: Array

    def at(self, chosen: NDArray[np.bool_]) -> "Features":
        return Features(self.pixels[chosen], self.descriptors[chosen], self.sizes[chosen])


FindFeatures = Callable[[int], Features]  # of a frame, by its number


@dataclass(frozen=True)
class Place:
    """keyframe: its number in the map. pixels (N,2), descriptors (N,128) as SIFT gives them, whole numbers below 256,
    points (N,3) in the map's world, sizes (N,) in pixels; guessed (N,): points whose depth is another's."""

    keyframe: int
    pixels: Array
    descriptors: NDArray[np.uint8]
    points: Array
    sizes: Array
    guessed: NDArray[np.bool_]

    @property
    def rooted(self) -> NDArray[np.float32]:
        """(N,128) RootSIFT; made anew each time, since all places of all maps are held until the joining ends."""
        return rooted(self.descriptors)

    @cached_property
    def triangles(self) -> Delaunay | None:
        """Of `pixels`, as `inverse_depth_at` takes them; a place is asked for its surface dozens of times."""
        return triangulated(self.pixels)


def match(first: NDArray[np.float32], second: NDArray[np.float32]) -> NDArray[np.int64]:
    """(K,2) rows of descriptors, of length one, that are each other's nearest and clearly nearer than the second
    nearest."""
    if len(first) < 2 or len(second) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    likeness = first @ second.T  # squared distances are 2 - 2 likeness
    row, nearest = np.arange(len(first)), likeness.argmax(axis=1)
    best = likeness[row, nearest]
    mutual = best == likeness.max(axis=0)[nearest]
    likeness[row, nearest] = -1
    good = mutual & (np.maximum(1 - best, 0) < RATIO**2 * (1 - likeness.max(axis=1)))
    _, once = np.unique(nearest[good], return_index=True)  # twins: one of them
    chosen = np.flatnonzero(good)[np.sort(once)]
    return np.stack([chosen, nearest[chosen]], axis=1)


def look_alikes(first: list[Place], second: list[Place], per_place: int, seed: int) -> list[tuple[int, int]]:
    """Pairs of rows whose signatures (VLAD, see `place_recognition`) are nearest, most alike first."""
    words = learn_words(np.concatenate([p.descriptors for p in first + second]), seed)
    one = np.stack([vlad(p.rooted, words) for p in first])
    other = np.stack([vlad(p.rooted, words) for p in second])
    likeness = one @ other.T
    order = np.argsort(-likeness, axis=1, kind="stable")[:, :per_place]
    pairs = [(float(-likeness[i, j]), i, int(j)) for i in range(len(first)) for j in order[i]]
    return [(i, j) for _, i, j in sorted(pairs)]


def rooted(descriptors: NDArray[np.uint8]) -> NDArray[np.float32]:
    """SIFT to RootSIFT, (N,128)."""
    whole = descriptors.astype(np.float32)
    return np.sqrt(whole / np.maximum(whole.sum(axis=1, keepdims=True), 1e-6)).astype(np.float32)


def sift(rgb: NDArray[np.uint8], mask: NDArray[np.uint8], contrast: float) -> Features:
    """The strongest SIFT features of a picture (H,W,3) within a mask (H,W)."""
    # Without `enable_precise_upscale` OpenCV puts every feature a quarter of a pixel too far right and down.
    detector = cv2.SIFT.create(nfeatures=FEATURES, contrastThreshold=contrast, enable_precise_upscale=True)
    keypoints, descriptors = detector.detectAndCompute(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), mask)
    if descriptors is None:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), dtype=np.uint8), np.zeros(0))
    pixels = np.array([k.pt for k in keypoints], dtype=np.float64) + 0.5
    return Features(pixels, descriptors.astype(np.uint8), np.array([k.size for k in keypoints]))


def triangulated(pixels: Array) -> Delaunay | None:
    """Delaunay's triangles of pixels (K,2); None if they have none."""
    try:
        return Delaunay(pixels) if len(pixels) > 3 else None
    except QhullError:  # all on one line
        return None


def inverse_depth_at(pixels: Array, known: Delaunay | None, depth: Array) -> Array:
    """(N,) inverse depth at pixels (N,2) from `triangulated` ones of depth (K,), linear as it is across a plane's
    image; NaN outside their hull, and everywhere if they have none."""
    if known is None:
        return np.full(len(pixels), np.nan)
    return LinearNDInterpolator(known, 1 / depth)(pixels)


def learn_words(descriptors: NDArray[np.uint8], seed: int) -> NDArray[np.float32]:
    """(WORDS,128) k-means centres of a sample, of RootSIFT."""
    if len(descriptors) > SAMPLE:
        chosen = np.random.default_rng(seed).choice(len(descriptors), SAMPLE, replace=False)
        descriptors = descriptors[np.sort(chosen)]
    cv2.setRNGSeed(seed + 1)
    criteria = (cv2.TERM_CRITERIA_MAX_ITER, 15, 0.0)
    return cv2.kmeans(rooted(descriptors), min(WORDS, len(descriptors)), None, criteria, 1, cv2.KMEANS_PP_CENTERS)[2]
