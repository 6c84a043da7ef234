"""Does the predicted confidence mean anything? Error against it by deciles, and their rank correlation."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from completion.errors import CompletionError

Array = NDArray[np.floating]
DECILES = 10
PIXELS_PER_FRAME = 2000  # keeps an evaluation of ten thousand frames in memory


@dataclass(frozen=True)
class Calibration:
    """Deciles of pixels from the most to the least trusted."""

    predicted: list[float]  # median predicted relative error in each decile
    actual: list[float]  # median actual relative error in each decile
    spearman: float  # of predicted and actual error over all pixels
    spearman_if_exact: float  # what it would be if errors were Laplace with exactly the predicted scales
    within_one: float  # share of pixels whose error is below the predicted one (Laplace: 63 % if calibrated)
    pixels: int

    def to_dict(self) -> dict[str, object]:
        return asdict(self)


def relative_errors(
    prediction: Array, truth: Array, predicted_error: Array
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(predicted, actual) relative error at evenly spread valid pixels of one frame, for `calibrate`."""
    valid = ((truth > 0) & (prediction > 0) & np.isfinite(predicted_error)).ravel().nonzero()[0]
    valid = valid[:: max(1, len(valid) // PIXELS_PER_FRAME)]
    g = truth.ravel()[valid].astype(float)
    return predicted_error.ravel()[valid].astype(float), np.abs(prediction.ravel()[valid] - g) / g


def calibrate(pairs: Iterable[tuple[Array, Array]]) -> Calibration:
    """From (predicted relative error, actual relative error) of each frame's valid pixels, 1-D arrays."""
    predicted, actual = (np.concatenate(side) for side in zip(*pairs, strict=True))
    if len(predicted) < DECILES:
        raise CompletionError(f"calibration needs at least {DECILES} pixels, got {len(predicted)}")
    order = np.argsort(predicted, kind="stable")
    ideal = predicted * np.random.default_rng(0).exponential(size=len(predicted))
    groups = np.array_split(order, DECILES)
    return Calibration(
        predicted=[float(np.median(predicted[group])) for group in groups],
        actual=[float(np.median(actual[group])) for group in groups],
        spearman=float(spearmanr(predicted, actual).statistic),
        spearman_if_exact=float(spearmanr(predicted, ideal).statistic),
        within_one=float(np.mean(actual < predicted)),
        pixels=len(predicted),
    )
