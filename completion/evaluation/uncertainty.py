"""Calibration of the predicted error: actual error by deciles of it, and their rank correlation."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from haustra.core.errors import CompletionError

Array = NDArray[np.floating]
DECILES = 10
PIXELS_PER_FRAME = 2000  # keeps an evaluation of ten thousand frames in memory


@dataclass(frozen=True)
class ErrorCalibration:
    """Deciles of pixels from the most to the least trusted."""

    predicted: list[float]  # median predicted relative error in each decile
    actual: list[float]  # median actual relative error in each decile
    spearman: float  # of predicted and actual relative error over all pixels
    spearman_if_exact: float  # what it would be if errors were Laplace with exactly the predicted scales
    # The same in the unit of depth. What is far errs more, so that depth alone ranks errors, too: compare with that.
    spearman_absolute: float
    spearman_absolute_if_exact: float
    spearman_depth_alone: float  # of predicted depth and actual error in its unit
    within_one: float  # share of pixels whose error is below the predicted one (Laplace: 63 % if calibrated)
    pixels: int

    def to_dict(self) -> dict[str, object]:
        return asdict(self)


class PixelErrors(NamedTuple):
    """Values at some valid pixels (N,) of one frame."""

    predicted: NDArray[np.float64]  # relative
    depth: NDArray[np.float64]  # predicted
    truth: NDArray[np.float64]

    @property
    def actual(self) -> NDArray[np.float64]:
        """Actual relative error (N,)."""
        return np.abs(self.depth - self.truth) / self.truth


def pixel_errors(prediction: Array, truth: Array, predicted_error: Array) -> PixelErrors:
    """Depth, truth and predicted relative error (H,W) at evenly spread valid pixels of one frame, for `calibrate`."""
    valid = ((truth > 0) & (prediction > 0) & np.isfinite(predicted_error)).ravel().nonzero()[0]
    valid = valid[:: max(1, len(valid) // PIXELS_PER_FRAME)]
    return PixelErrors(*(array.ravel()[valid].astype(float) for array in (predicted_error, prediction, truth)))


def calibrate(frames: Iterable[PixelErrors]) -> ErrorCalibration:
    """Calibration over the pixels of all frames."""
    pixels = PixelErrors(*(np.concatenate(part) for part in zip(*frames, strict=True)))
    predicted, actual = pixels.predicted, pixels.actual
    if len(predicted) < DECILES:
        raise CompletionError(f"calibration needs at least {DECILES} pixels, got {len(predicted)}")
    order = np.argsort(predicted, kind="stable")
    ideal = predicted * np.random.default_rng(0).exponential(size=len(predicted))
    groups = np.array_split(order, DECILES)
    absolute = np.abs(pixels.depth - pixels.truth)
    return ErrorCalibration(
        predicted=[float(np.median(predicted[group])) for group in groups],
        actual=[float(np.median(actual[group])) for group in groups],
        spearman=float(spearmanr(predicted, actual).statistic),
        spearman_if_exact=float(spearmanr(predicted, ideal).statistic),
        spearman_absolute=float(spearmanr(predicted * pixels.depth, absolute).statistic),
        spearman_absolute_if_exact=float(spearmanr(predicted * pixels.depth, ideal * pixels.depth).statistic),
        spearman_depth_alone=float(spearmanr(pixels.depth, absolute).statistic),
        within_one=float(np.mean(actual < predicted)),
        pixels=len(predicted),
    )
