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
from scipy.stats import spearmanr

from pipeline.mapping.submap import Submap

MIN_POINTS = 15  # fewer do not give a rank correlation worth asking
DARKEST, BRIGHTEST = 8.0, 245.0  # grey levels between which brightness follows the light
MIN_VIEWS = 3  # of a point that is compared with itself
CENTRING_ROUNDS = 6  # alternating means of points and frames converge within a few
TELLING_SPREAD = 0.05  # of log distance, about its means, from which a correlation is taken as it is


@dataclass(frozen=True)
class LightingCheck:
    """Figures that speak for or against a submap.

    frames, points: counts. reprojection_px: mean. angle_deg: median triangulation angle. spearman: median over
    frames of the rank correlation of distance and brightness (-1 is perfect). inconsistent_share: share of the
    checked frames whose correlation is positive. n_checked: frames with enough points for a correlation.
    same_point: correlation of log distance and log brightness of each point with itself over time, 0 where the motion
    does not tell (see `same_point_correlation`).
    """

    frames: int
    points: int
    reprojection_px: float
    angle_deg: float
    spearman: float
    inconsistent_share: float
    n_checked: int
    same_point: float = 0.0

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
    order, starts = submap.by_frame()
    frame, point = submap.observations[order].T
    pixels = submap.pixels[order]
    distance = np.linalg.norm(submap.points[point] - submap.centres[frame], axis=1)
    correlations = []
    logs = np.full((2, len(point)), np.nan)  # of distance and brightness, in the order of frames
    for row, index in enumerate(submap.frames):
        mine = slice(starts[row], starts[row + 1])
        if starts[row + 1] - starts[row] < MIN_POINTS:
            continue
        brightness = brightness_of(image_of(int(index)))
        height, width = brightness.shape
        x, y = np.floor(pixels[mine]).astype(int).T
        values = brightness[y.clip(0, height - 1), x.clip(0, width - 1)]
        told = (values > DARKEST) & (values < BRIGHTEST) & (distance[mine] > 0)
        logs[:, mine][:, told] = np.log(distance[mine][told]), np.log(values[told])
        correlation = spearmanr(distance[mine], values).statistic
        if np.isfinite(correlation):
            correlations.append(correlation)
    angles = submap.triangulation_angles()
    return LightingCheck(
        frames=len(submap.frames),
        points=len(submap.points),
        reprojection_px=float(submap.error_px.mean()) if len(submap.points) else float("inf"),
        angle_deg=float(np.median(angles)) if len(angles) else 0.0,
        spearman=float(np.median(correlations)) if correlations else 0.0,
        inconsistent_share=float((np.array(correlations) > 0).mean()) if correlations else 0.0,
        n_checked=len(correlations),
        same_point=same_point_correlation(frame, point, *logs),
    )


def same_point_correlation(
    frame: NDArray[np.int64], point: NDArray[np.int64], distance: NDArray[np.float64], brightness: NDArray[np.float64]
) -> float:
    """Does a point get darker as the camera leaves it? Correlation of log distance and log brightness (M,), NaN where
    unknown, after each point's and each frame's own mean is taken out of both; negative is right.

    A point's mean takes its colour with it, so that white and dark tissue side by side say nothing; a frame's mean, the
    exposure. Shrunk towards 0 where distances hardly change: then it is noise that correlates.
    """
    known = np.isfinite(distance) & np.isfinite(brightness)
    seen = np.bincount(point[known], minlength=int(point.max(initial=0)) + 1)
    known &= seen[point] >= MIN_VIEWS
    if known.sum() < MIN_POINTS:
        return 0.0
    rows, points = (np.unique(of[known], return_inverse=True)[1] for of in (frame, point))
    left = [distance[known].copy(), brightness[known].copy()]
    for _ in range(CENTRING_ROUNDS):
        for group in (points, rows):
            count = np.bincount(group)
            left = [values - (np.bincount(group, values) / count)[group] for values in left]
    spread = [float(np.sqrt((values**2).mean())) for values in left]
    if min(spread) < 1e-9:
        return 0.0
    correlation = float((left[0] * left[1]).mean() / (spread[0] * spread[1]))
    return correlation * min(1.0, spread[0] / TELLING_SPREAD)
