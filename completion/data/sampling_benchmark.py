"""Sparse depth for evaluation, one frame at a time: the paper's two samplers and the reference for SfM-like points.

Everything is drawn from a NumPy generator; counts are exact where the frame has that many candidates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import CompletionError

Pixels = NDArray[np.int64]
SIFT_CONTRAST = 0.005
NOISE, OUTLIERS, OUTLIER_FACTORS, LOG_SCALE = 0.03, 0.03, (0.5, 2.0), 2.0


@dataclass(frozen=True)
class Sparse:
    """Sparse depth (H,W) float32, 0 = none, and the factor by which it differs from the truth's unit."""

    depth: NDArray[np.float32]
    factor: float

    @property
    def points(self) -> int:
        return int((self.depth > 0).sum())


def uniform(rgb: NDArray[np.uint8], truth: NDArray[np.float32], points: int, rng: np.random.Generator) -> Sparse:
    """US-SD: pixels with truth at random, without replacement; exact depth."""
    return _keep(truth, _everywhere(truth, rng), points)


def by_chance(rgb: NDArray[np.uint8], truth: NDArray[np.float32], points: int, rng: np.random.Generator) -> Sparse:
    """Each pixel with truth by itself with one probability, so that `points` is the mean of the counts (the released
    code of Ma and Karaman, ICRA 2018); exact depth."""
    candidates = int((truth > 0).sum())
    return uniform(rgb, truth, int(rng.binomial(candidates, min(1.0, points / max(candidates, 1)))), rng)


def features(rgb: NDArray[np.uint8], truth: NDArray[np.float32], points: int, rng: np.random.Generator) -> Sparse:
    """FS-SD: SIFT keypoints, strongest first; where they run out, uniform pixels; exact depth.

    The paper does not name its detector. SIFT is that of the front end which the network is meant for.
    """
    return _keep(truth, np.concatenate([_keypoints(rgb, None), _everywhere(truth, rng)]), points)


def like_sfm(rgb: NDArray[np.uint8], truth: NDArray[np.float32], points: int, rng: np.random.Generator) -> Sparse:
    """SIFT keypoints (contrast threshold 0.005) at random; depth times 1 + 0.03 N(0,1), 3 % of the points times
    U(0.5, 2), and all of a frame times one unknown factor in [e^-2, e^2]. Fewer points where there are fewer."""
    chosen = _keep(truth, _keypoints(rgb, rng), points).depth
    rows, columns = np.nonzero(chosen)
    values = chosen[rows, columns] * (1 + NOISE * rng.standard_normal(len(rows)))
    wrong = rng.random(len(rows)) < OUTLIERS
    values[wrong] *= rng.uniform(*OUTLIER_FACTORS, wrong.sum())
    factor = float(np.exp(rng.uniform(-LOG_SCALE, LOG_SCALE)))
    depth = np.zeros_like(chosen)
    depth[rows, columns] = values * factor
    return Sparse(depth, factor)


Sampler = Callable[[NDArray[np.uint8], NDArray[np.float32], int, np.random.Generator], Sparse]
SAMPLERS: dict[str, Sampler] = {"uniform": uniform, "by_chance": by_chance, "features": features, "sfm": like_sfm}


def get_sampler(name: str) -> Sampler:
    """A sampler by name; CompletionError if there is none."""
    if name not in SAMPLERS:
        raise CompletionError(f"no sampler {name!r}; known: {', '.join(SAMPLERS)}")
    return SAMPLERS[name]


def _everywhere(truth: NDArray[np.float32], rng: np.random.Generator) -> Pixels:
    """All pixels (K,2) row, column in random order."""
    rows, columns = np.unravel_index(rng.permutation(truth.size), truth.shape)
    return np.stack([rows, columns], axis=1)


def _keypoints(rgb: NDArray[np.uint8], rng: np.random.Generator | None) -> Pixels:
    """SIFT keypoints (K,2) row, column: in random order, or strongest first without a generator."""
    opencv: Any = cv2  # its type stubs lack SIFT
    found = opencv.SIFT_create(contrastThreshold=SIFT_CONTRAST).detect(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY))
    if not found:
        return np.empty((0, 2), np.int64)
    # OpenCV counts from the first pixel's centre, so rounding gives the pixel.
    places = np.array([point.pt[::-1] for point in found]).round().astype(np.int64)
    if rng is not None:
        return places[rng.permutation(len(found))]
    return places[np.argsort([-point.response for point in found], kind="stable")]


def _keep(truth: NDArray[np.float32], places: Pixels, points: int) -> Sparse:
    """The first `points` different places with truth."""
    inside = ((places >= 0) & (places < truth.shape)).all(axis=1)
    flat = np.ravel_multi_index(tuple(places[inside].T), truth.shape)
    first = np.sort(np.unique(flat, return_index=True)[1])
    flat = flat[first]
    flat = flat[truth.ravel()[flat] > 0][:points]
    depth = np.zeros_like(truth)
    depth.ravel()[flat] = truth.ravel()[flat]
    return Sparse(depth, 1.0)
