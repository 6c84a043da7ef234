"""Depth errors and the conventions under which the field averages them.

The paper's five (RMSE, abs.REL, MAE, delta_1, delta_2) over pixels with truth, per frame. Its averaging is not stated;
by the lineage of its code (Sparse-to-Dense) it is the mean of per-frame values, called `per_frame` here. `pooled`
weighs every pixel the same instead. SimCol3D's challenge has its own three figures (`simcol3d_errors`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import CompletionError

Depth = NDArray[np.floating]
Alignment = Literal["none", "points", "median", "least_squares"]
Averaging = Literal["per_frame", "pooled"]
DELTA_BASE = 1.25


@dataclass(frozen=True)
class DepthErrors:
    """Errors of one depth map, or their mean. Lengths in the truth's unit; abs_rel and deltas are fractions."""

    rmse: float
    abs_rel: float  # mean of |p - g| / g
    mae: float
    delta_1: float  # share of pixels with max(p/g, g/p) < 1.25
    delta_2: float  # < 1.25^2
    delta_3: float  # < 1.25^3
    scale: float  # the factor that the alignment put on the prediction
    pixels: int  # with truth and with a prediction
    missing: int  # with truth, without a prediction: in no error above, but never silently left out

    def to_dict(self) -> dict[str, float]:
        return asdict(self)


def depth_errors(
    prediction: Depth, truth: Depth, alignment: Alignment = "none", sparse: Depth | None = None
) -> DepthErrors:
    """Errors of a prediction (H,W) against truth (H,W), over pixels where truth is positive.

    A prediction that is zero, negative or not finite is missing. Alignment multiplies the prediction by one factor:
    `points`: the median ratio at the sparse points (the only one that needs no truth elsewhere, and the fair one for
    SfM input); `median`: ratio of medians over all pixels; `least_squares`: the factor of least squared error.
    """
    if prediction.shape != truth.shape:
        raise CompletionError(f"prediction {prediction.shape} and truth {truth.shape} differ in size")
    known = truth > 0
    valid = known & np.isfinite(prediction) & (prediction > 0)
    if not valid.any():
        raise CompletionError("no pixel has both truth and a prediction")
    p, g = prediction[valid].astype(float), truth[valid].astype(float)
    scale = _scale(p, g, alignment, prediction, truth, sparse)
    p = p * scale
    error, ratio = np.abs(p - g), np.maximum(p / g, g / p)
    return DepthErrors(
        rmse=float(np.sqrt(np.mean(error**2))),
        abs_rel=float(np.mean(error / g)),
        mae=float(error.mean()),
        delta_1=float(np.mean(ratio < DELTA_BASE)),
        delta_2=float(np.mean(ratio < DELTA_BASE**2)),
        delta_3=float(np.mean(ratio < DELTA_BASE**3)),
        scale=scale,
        pixels=int(valid.sum()),
        missing=int(known.sum() - valid.sum()),
    )


def _scale(p: Depth, g: Depth, alignment: Alignment, prediction: Depth, truth: Depth, sparse: Depth | None) -> float:
    if alignment == "none":
        return 1.0
    if alignment == "median":
        return float(np.median(g) / np.median(p))
    if alignment == "least_squares":
        return float((p @ g) / (p @ p))
    if alignment == "points":
        if sparse is None:
            raise CompletionError("alignment 'points' needs the sparse depth")
        here = (sparse > 0) & (truth > 0) & np.isfinite(prediction) & (prediction > 0)
        if not here.any():
            raise CompletionError("alignment 'points' finds no sparse point with truth")
        return float(np.median(truth[here] / prediction[here]))
    raise CompletionError(f"alignment is one of {', '.join(get_args(Alignment))}, not {alignment!r}")


def average(frames: Sequence[DepthErrors], averaging: Averaging = "per_frame") -> DepthErrors:
    """Mean of per-frame errors, or the errors of all pixels pooled (weights by pixels, RMSE by mean square)."""
    if not frames:
        raise CompletionError("there are no frames to average")
    if averaging not in get_args(Averaging):
        raise CompletionError(f"averaging is one of {', '.join(get_args(Averaging))}, not {averaging!r}")
    pixels = np.array([frame.pixels for frame in frames], float)
    weights = pixels / pixels.sum() if averaging == "pooled" else np.full(len(frames), 1 / len(frames))
    mean = {
        field.name: float(weights @ [getattr(frame, field.name) for frame in frames])
        for field in fields(DepthErrors)
        if field.name not in ("pixels", "missing")
    }
    if averaging == "pooled":
        mean["rmse"] = float(np.sqrt(weights @ [frame.rmse**2 for frame in frames]))
    return DepthErrors(
        **mean, pixels=sum(frame.pixels for frame in frames), missing=sum(frame.missing for frame in frames)
    )


@dataclass(frozen=True)
class SimCol3DDepthErrors:
    """SimCol3D's task 1 (repository anitarau/simcol, evaluation/eval_synthetic_depth.py), one trajectory."""

    l1: float  # mean over frames of the mean absolute error
    rmse: float  # mean over frames of the root mean squared error
    median_relative: float  # mean over frames of the *median* relative error, a fraction
    scale: float  # one least-squares factor for the trajectory, from the frames' mean depths
    frames: int


def simcol3d_errors(pairs: Callable[[], Iterable[tuple[Depth, Depth]]]) -> SimCol3DDepthErrors:
    """Errors of a trajectory's (prediction, truth) pairs, in the truth's unit; truth 0 is left out.

    `pairs` is called twice, for the scale and for the errors under it, so that nobody need hold a whole trajectory.
    """

    def known() -> Iterator[tuple[Depth, Depth]]:
        for prediction, truth in pairs():
            yield prediction[truth > 0].astype(float), truth[truth > 0].astype(float)

    means = np.array([(p.mean(), g.mean()) for p, g in known()])
    if not len(means):
        raise CompletionError("there are no frames to average")
    predicted, true = means.T
    scale = float((predicted @ true) / (predicted @ predicted))
    errors = np.array([_absolute_squared_relative(np.abs(scale * p - g), g) for p, g in known()])
    l1, rmse, median = errors.mean(axis=0).tolist()
    return SimCol3DDepthErrors(l1, rmse, median, scale, len(means))


def _absolute_squared_relative(error: Depth, truth: Depth) -> tuple[float, float, float]:
    return float(error.mean()), float(np.sqrt(np.mean(error**2))), float(np.median(error / truth))
