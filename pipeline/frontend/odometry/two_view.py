"""Relative pose of two views: several hypotheses, ranked by inliers and by the lighting check.

Five-point essential matrices and a homography each give a few poses. A plane, little parallax or one false sample can
make a wrong one fit two views as well as the right one, so each is asked for more: depths in front of both cameras, a
third view that was not used, and the endoscope's lamp, under which nearer is brighter.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.rank_correlation import rank_correlation
from haustra.core.se3 import Array, angle_between, compose, share_of
from pipeline.optimization.bundle_adjustment import Bundle, adjust
from pipeline.optimization.resection import refine_pose, reprojection_errors
from pipeline.optimization.triangulation import triangulate

DRAW_PX = (0.3, 0.5, 0.7, 1.0)  # thresholds of the essential matrices drawn: a wide one lets a tolerable sample win
FINALISTS = 4
REFINEMENTS = 25  # fewer leave half-converged copies of the best as its rivals
MIN_POINTS = 30
CLEARLY_WORSE = 0.85  # times the best support: a rival below it is out
MAX_LIGHTING_CORRELATION = 0.1  # rank correlation of distance and brightness above which the lamp says no
MIN_LIGHTING_MARGIN = 0.2  # difference of that correlation that settles it between two equals
SAME_ANGLE = np.radians(1.0)
SAME_DIRECTION = np.radians(12.0)
MIN_CHECKED_POINTS = 15


@dataclass(frozen=True)
class TwoViewRays:
    """The same tracks in one view: xy (N,2) on the plane z = 1, jacobian (N,2,2) pixels per unit."""

    xy: Array
    jacobian: Array


@dataclass(frozen=True)
class StartLimits:
    """What two frames must show before a map begins with them.

    parallax_px: least median way of the tracks that no rotation explains. angle_deg: least median angle between the
    rays of a point. error_px: largest error of a point, in any of three views. share: least, of the tracks that have
    such points. The error of a track is some 0.3 px, whatever the size of the image.
    """

    parallax_px: float
    angle_deg: float
    error_px: float
    share: float

    def __str__(self) -> str:
        return f"{self.parallax_px:g} px and {self.angle_deg:g} degrees of parallax"


USUAL_START = StartLimits(6.4, 1.5, 1.5, 0.6)
# For a film in which no map begins by the usual ones. A wall that moves and a camera that does not can look like little
# parallax: the less there is, the nearer the points must lie to what is seen, and the more of them.
START_WITH_LITTLE_PARALLAX = StartLimits(3.0, 0.7, 0.7, 0.9)


@dataclass(frozen=True)
class Hypothesis:
    """Pose of the second camera, and what speaks for it.

    second_from_first: |t| = 1. points (N,3) in the first camera. inlier (N,) in all views. angle_deg: median.
    support: mean over the tracks of 1 - (error / limit)^2, none below 0: it tells a good fit from a tolerable one,
    where with little parallax a count cannot. lighting: rank correlation of distance and brightness over the inliers,
    0 if not asked.
    """

    second_from_first: Array
    points: Array
    inlier: NDArray[np.bool_]
    support: float
    angle_deg: float
    lighting: float

    @property
    def share(self) -> float:
        return float(self.inlier.mean())


def parallax_px(first: TwoViewRays, second: TwoViewRays, focal_px: float) -> float:
    """Median way of the tracks that no rotation explains, in pixels at the image's centre."""
    rays = [np.concatenate([s.xy, np.ones((len(s.xy), 1))], axis=1) for s in (first, second)]
    a, b = (r / np.linalg.norm(r, axis=1, keepdims=True) for r in rays)
    weight = np.ones(len(a))
    for _ in range(4):
        u, _, vt = np.linalg.svd((b * weight[:, None]).T @ a)
        rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
        off = np.linalg.norm(b - a @ rotation.T, axis=1)
        weight = 1 / np.maximum(off, 1e-4)
    return float(np.median(off) * focal_px)


def start_pose(
    first: TwoViewRays,
    second: TwoViewRays,
    third: TwoViewRays,
    brightness: Array | None,
    focal_px: float,
    rng: np.random.Generator,
    limits: StartLimits = USUAL_START,
) -> Hypothesis | None:
    """The hypothesis that the evidence prefers clearly, or None: ask again when the camera has moved on.

    brightness: (N,) of the tracks in the second view, or None.
    """
    if len(first.xy) < MIN_POINTS:
        return None
    scored = [
        score_hypothesis(second_from_first, first, second, third, brightness, limits.error_px)
        for second_from_first in propose(first, second, focal_px, rng, limits.error_px)
    ]
    scored = [h for h in scored if h.inlier.sum() >= MIN_POINTS]
    lit = [h for h in scored if h.lighting <= MAX_LIGHTING_CORRELATION]
    if not lit:
        return None
    best, most = (max(group, key=lambda h: h.support) for group in (lit, scored))
    if best.share < limits.share or best.angle_deg < limits.angle_deg or best.support < CLEARLY_WORSE * most.support:
        return None
    rivals = [
        h
        for h in lit
        if not _is_same(h.second_from_first, best.second_from_first) and h.support > CLEARLY_WORSE * best.support
    ]
    if any(h.lighting < best.lighting + MIN_LIGHTING_MARGIN for h in rivals):
        return None
    return best


def propose(
    first: TwoViewRays, second: TwoViewRays, focal_px: float, rng: np.random.Generator, max_error_px: float
) -> list[Array]:
    """Poses (4x4, second_from_first, |t| = 1) worth a closer look, those with most points in front first."""
    cameras_from_first: list[Array] = []
    for limit in DRAW_PX:
        limit_px = limit * (max_error_px / USUAL_START.error_px)
        cameras_from_first += _from_essential(first.xy, second.xy, limit_px / focal_px, rng)
    cameras_from_first += _from_homography(first.xy, second.xy, focal_px, rng)
    counts = [_fitting(second_from_first, first, second, max_error_px) for second_from_first in cameras_from_first]
    counted = sorted(((count, k) for k, count in enumerate(counts)), reverse=True)
    chosen: list[Array] = []
    for count, k in counted:
        if (
            len(chosen) < FINALISTS
            and count >= MIN_POINTS
            and not any(_is_same(cameras_from_first[k], c) for c in chosen)
        ):
            chosen.append(cameras_from_first[k])
    return chosen


def score_hypothesis(
    second_from_first: Array,
    first: TwoViewRays,
    second: TwoViewRays,
    third: TwoViewRays,
    brightness: Array | None,
    max_error_px: float,
) -> Hypothesis:
    """Refine a pose and its points on two views, then ask the third view and the lamp."""
    second_from_first, points, error, angle = _refined(second_from_first, first, second, max_error_px)
    inlier = (error < max_error_px) & (points[:, 2] > 0)
    if inlier.sum() < MIN_POINTS:
        return Hypothesis(second_from_first, points, np.zeros(len(points), dtype=bool), 0.0, 0.0, 0.0)
    halfway = share_of(second_from_first, 0.5)
    middle = refine_pose(halfway, points[inlier], third.xy[inlier], third.jacobian[inlier], max_error_px, iterations=15)
    error = np.maximum(error, reprojection_errors(middle, points, third.xy, third.jacobian))
    inlier = (error < max_error_px) & (points[:, 2] > 0)
    support = float(np.where(inlier, 1 - np.minimum(error / max_error_px, 1) ** 2, 0).mean())
    lighting = 0.0
    if brightness is not None and inlier.sum() >= MIN_CHECKED_POINTS:
        distance = np.linalg.norm(points[inlier] @ second_from_first[:3, :3].T + second_from_first[:3, 3], axis=1)
        lighting = float(np.nan_to_num(rank_correlation(distance, brightness[inlier])))
    angle_deg = float(np.degrees(np.median(angle[inlier]))) if inlier.any() else 0.0
    return Hypothesis(second_from_first, points, inlier, support, angle_deg, lighting)


def _refined(
    second_from_first: Array, first: TwoViewRays, second: TwoViewRays, max_error_px: float
) -> tuple[Array, Array, Array, Array]:
    """Pose with |t| = 1, points, worst error and ray angle of each, after adjusting both to the two views."""
    points, error, _ = _triangulated(second_from_first, first, second)
    take = np.flatnonzero(error < 3 * max_error_px)
    if len(take) >= MIN_POINTS:
        count = len(take)
        cameras_from_first = np.stack([np.eye(4), second_from_first])
        bundle = Bundle(
            cameras_from_first[:, :3, :3], cameras_from_first[:, :3, 3], points[take],
            np.repeat([0, 1], count), np.tile(np.arange(count), 2),
            np.concatenate([first.xy[take], second.xy[take]]),
            np.concatenate([first.jacobian[take], second.jacobian[take]]),
            np.array([True, False]),
        )  # fmt: skip
        result = adjust(bundle, REFINEMENTS, max_error_px)
        second_from_first = compose(result.rotation[1], result.translation[1])
        second_from_first[:3, 3] /= max(float(np.linalg.norm(second_from_first[:3, 3])), 1e-12)
    points, error, angle = _triangulated(second_from_first, first, second)
    return second_from_first, points, error, angle


def _triangulated(second_from_first: Array, first: TwoViewRays, second: TwoViewRays) -> tuple[Array, Array, Array]:
    count = len(first.xy)
    cameras_from_first = np.tile(np.stack([np.eye(4), second_from_first]), (count, 1, 1))
    xy = np.stack([first.xy, second.xy], axis=1).reshape(-1, 2)
    jacobian = np.stack([first.jacobian, second.jacobian], axis=1).reshape(-1, 2, 2)
    return triangulate(
        cameras_from_first[:, :3, :3], cameras_from_first[:, :3, 3], np.repeat(np.arange(count), 2), count, xy, jacobian
    )


def _fitting(second_from_first: Array, first: TwoViewRays, second: TwoViewRays, max_error_px: float) -> int:
    return int((_triangulated(second_from_first, first, second)[1] < max_error_px).sum())


def _from_essential(first: Array, second: Array, limit: float, rng: np.random.Generator) -> list[Array]:
    found, _ = cv2.findEssentialMat(
        first, second, np.eye(3), np.eye(3), np.zeros(4), np.zeros(4), _consensus(limit, rng)
    )
    if found is None or found.shape != (3, 3):
        return []
    one, other, direction = cv2.decomposeEssentialMat(found)
    return [compose(turn, sign * direction.ravel()) for turn in (one, other) for sign in (1, -1)]


def _from_homography(first: Array, second: Array, focal_px: float, rng: np.random.Generator) -> list[Array]:
    found, _ = cv2.findHomography(first, second, _consensus(2.0 / focal_px, rng))
    if found is None or found.shape != (3, 3):
        return []
    _, turns, shifts, _ = cv2.decomposeHomographyMat(found, np.eye(3))
    lengths = [float(np.linalg.norm(shift)) for shift in shifts]
    return [compose(t, s.ravel() / n) for t, s, n in zip(turns, shifts, lengths, strict=True) if n > 1e-6]


def _consensus(threshold: float, rng: np.random.Generator) -> cv2.UsacParams:
    params = cv2.UsacParams()
    params.threshold, params.confidence, params.maxIterations = threshold, 0.99999, 1000
    params.score, params.loMethod = cv2.SCORE_METHOD_MSAC, cv2.LOCAL_OPTIM_INNER_LO
    params.randomGeneratorState = int(rng.integers(1, 2**31 - 1))
    return params


def _is_same(first: Array, second: Array) -> bool:
    cosine = float(np.clip(first[:3, 3] @ second[:3, 3], -1, 1))
    return angle_between(first, second) < SAME_ANGLE and np.arccos(cosine) < SAME_DIRECTION
