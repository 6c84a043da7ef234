"""Lighting check: does brightness fall with distance from the camera, as the lamp beside it demands?

The lamp sits at the camera, so brightness falls with the square of the distance, and in a true model nearer points are
brighter in every frame. Wrong models (a false two-view start registers every frame with a fine reprojection error) pass
on average but fail in single frames, so each frame is checked.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.rank_correlation import rank_correlation
from pipeline.mapping.submap import Submap

MIN_POINTS = 15  # fewer do not give a rank correlation worth asking
CONTRADICTION = 1.0  # frames that agree, which one that contradicts its light outweighs: ends that mostly do are cut


@dataclass(frozen=True)
class LightingCheck:
    """Figures that speak for or against a submap.

    frames, points: counts. reprojection_px: mean. angle_deg: median triangulation angle. spearman: median over
    frames of the rank correlation of distance and brightness (-1 is perfect). inconsistent_share: share of the
    checked frames whose correlation is positive by more than chance has it. n_checked: frames with enough points for a
    correlation.
    """

    frames: int
    points: int
    reprojection_px: float
    angle_deg: float
    spearman: float
    inconsistent_share: float
    n_checked: int

    def to_dict(self) -> dict[str, float]:
        """For run.yaml and metrics.json, whose keys are those of version 0.1."""
        names = {"inconsistent_share": "contrary", "n_checked": "voters"}
        return {names.get(name, name): value for name, value in asdict(self).items()}


def brightness_of(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Smoothed brightest channel: red saturates last to zero in blood, blue first; (H,W) float32."""
    sigma = 0.012 * rgb.shape[1]
    return cv2.GaussianBlur(np.maximum.reduce(cv2.split(rgb)).astype(np.float32), (0, 0), sigma)


def check_lighting(submap: Submap, image_of: Callable[[int], NDArray[np.uint8]]) -> LightingCheck:
    """LightingCheck for a submap; `image_of(frame)` gives the (H,W,3) uint8 image."""
    return summarised(submap, lighting_correlations(submap, image_of))


def lighting_correlations(submap: Submap, image_of: Callable[[int], NDArray[np.uint8]]) -> NDArray[np.float64]:
    """Rank correlation (N,) of distance and brightness in each frame, NaN where it has too few points; 0 where it is
    positive by no more than the standard deviation of the correlation of as many unrelated values, 1 / sqrt(n - 1)."""
    order, starts = submap.by_frame()
    frame, point = submap.observations[order].T
    pixels = submap.pixels[order]
    distance = np.linalg.norm(submap.points[point] - submap.centres[frame], axis=1)
    correlations = np.full(len(submap.frames), np.nan)
    for row, index in enumerate(submap.frames):
        mine = slice(starts[row], starts[row + 1])
        if starts[row + 1] - starts[row] < MIN_POINTS:
            continue
        brightness = brightness_of(image_of(int(index)))
        height, width = brightness.shape
        x, y = np.floor(pixels[mine]).astype(int).T
        values = brightness[y.clip(0, height - 1), x.clip(0, width - 1)]
        correlation = rank_correlation(distance[mine], values)
        by_chance = 0 < correlation <= 1 / np.sqrt(len(values) - 1)
        correlations[row] = 0.0 if by_chance else correlation
    return correlations


def summarised(submap: Submap, correlations: NDArray[np.float64]) -> LightingCheck:
    """LightingCheck of a submap by its frames' correlations (N,)."""
    known = correlations[np.isfinite(correlations)]
    angles = submap.triangulation_angles()
    return LightingCheck(
        frames=len(submap.frames),
        points=len(submap.points),
        reprojection_px=float(submap.error_px.mean()) if len(submap.points) else float("inf"),
        angle_deg=float(np.median(angles)) if len(angles) else 0.0,
        spearman=float(np.median(known)) if len(known) else 0.0,
        inconsistent_share=float((known > 0).mean()) if len(known) else 0.0,
        n_checked=len(known),
    )


def best_stretch(correlations: NDArray[np.float64]) -> tuple[int, int]:
    """First row and end of the frames in a row that agree best with their light: each frame that does counts 1, each
    that contradicts it `CONTRADICTION` against.

    A map that goes wrong does so from some frame on: what was right before is kept.
    """
    with np.errstate(invalid="ignore"):
        value = np.where(np.isfinite(correlations), np.where(correlations > 0, -CONTRADICTION, 1.0), 0.0)
    total = np.concatenate([[0.0], np.cumsum(value)])
    lowest = np.minimum.accumulate(total)
    end = int(np.argmax(total - lowest))
    return int(np.argmin(total[: end + 1])), end
