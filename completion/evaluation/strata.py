"""Predicted and actual error by stratum: near wall, far wall, burnt wall, border, far from points, edges of folds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

Depth = NDArray[np.floating]
Mask = NDArray[np.bool_]

NEAR, FAR = 0.3, 2.0  # of the frame's median true depth
BURNT = 245  # grey levels that two of three channels reach
BORDER = 0.05  # of the width, from the edge of the truth
FAR_FROM_POINTS_PX = 40.0
EDGE_STEP, EDGE_PX = 1.1, 8  # ratio of true depths within 3x3 px that is a step, and how far around it counts
KEPT_CONFIDENCE = 0.1  # least that `reconstruct` fuses
CLOSE = 0.05  # relative error


@dataclass(frozen=True)
class Stratum:
    """Pixels of one stratum, over all frames."""

    pixels: int
    within_one: float  # share whose error is below the predicted one; 0.63 if calibrated (Laplace)
    abs_rel: float  # mean relative error
    median_rel: float  # median over frames of the frame's median relative error
    kept: float  # share of confidence KEPT_CONFIDENCE or more
    kept_close: float | None  # share of those that err by less than CLOSE; None where none is kept

    def to_dict(self) -> dict[str, float | None]:
        return asdict(self)


@dataclass(frozen=True)
class FrameStratum:
    """The same of one frame, as sums."""

    pixels: int
    within: int
    total_error: float
    median_error: float
    kept: int
    kept_close: int


def strata_masks(rgb: NDArray[np.uint8], truth: Depth, sparse: Depth) -> dict[str, Mask]:
    """Masks (H,W) by name, of pixels with truth; a pixel may be in several. rgb (H,W,3), truth and sparse depth (H,W),
    0 = none."""
    known = truth > 0
    if not known.any():
        return {}
    median = np.median(truth[known])
    away = distance_transform_edt(sparse <= 0) if (sparse > 0).any() else np.full(truth.shape, np.inf)
    framed = np.pad(known, 1)
    inside = distance_transform_edt(framed)[1:-1, 1:-1]
    return {
        "all": known,
        "near": known & (truth < NEAR * median),
        "far": known & (truth > FAR * median),
        "burnt": known & (np.median(rgb, axis=2) >= BURNT),
        "border": known & (inside <= BORDER * truth.shape[1]),
        "over 40 px from a point": known & (away > FAR_FROM_POINTS_PX),
        "fold edges": known & _near_steps(truth.astype(np.float32)),
    }


def _near_steps(truth: NDArray[np.float32]) -> Mask:
    window = np.ones((3, 3), np.uint8)
    nearest = cv2.erode(np.where(truth > 0, truth, np.float32(np.inf)), window)
    step = (cv2.dilate(truth, window) / EDGE_STEP > nearest) & (truth > 0)
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * EDGE_PX + 1, 2 * EDGE_PX + 1))
    return cv2.dilate(step.astype(np.uint8), around) > 0


def frame_strata(
    rgb: NDArray[np.uint8], truth: Depth, sparse: Depth, prediction: Depth, error: Depth, confidence: Depth
) -> dict[str, FrameStratum]:
    """Sums of one frame by stratum; a stratum without a pixel is absent. error: predicted, relative (H,W)."""
    found = {}
    for name, mask in strata_masks(rgb, truth, sparse).items():
        here = mask & (prediction > 0)
        if not here.any():
            continue
        actual = np.abs(prediction[here] - truth[here]) / truth[here]
        kept = confidence[here] >= KEPT_CONFIDENCE
        found[name] = FrameStratum(
            pixels=int(here.sum()),
            within=int((actual < error[here]).sum()),
            total_error=float(actual.sum()),
            median_error=float(np.median(actual)),
            kept=int(kept.sum()),
            kept_close=int((actual[kept] < CLOSE).sum()),
        )
    return found


def merged_strata(frames: Sequence[dict[str, FrameStratum]]) -> dict[str, Stratum]:
    """Strata over all frames, every pixel the same."""
    merged = {}
    for name in dict.fromkeys(name for frame in frames for name in frame):
        parts = [frame[name] for frame in frames if name in frame]
        pixels, kept = sum(p.pixels for p in parts), sum(p.kept for p in parts)
        merged[name] = Stratum(
            pixels=pixels,
            within_one=sum(p.within for p in parts) / pixels,
            abs_rel=sum(p.total_error for p in parts) / pixels,
            median_rel=float(np.median([p.median_error for p in parts])),
            kept=kept / pixels,
            kept_close=sum(p.kept_close for p in parts) / kept if kept else None,
        )
    return merged
