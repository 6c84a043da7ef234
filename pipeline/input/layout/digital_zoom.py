"""Parts of a film in which the processor shows a cut-out of its picture enlarged: another lens within the same outline.

From one frame to the next all of the picture then grows by one factor about its middle, whatever the depth. A scope
that moves forward never does that: near wall grows more than far wall, and no scope comes a tenth nearer in a frame
after it hardly moved in the one before.
"""

from collections import deque

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.input.frame_quality import Verdict

THUMBNAIL = (64, 64)
HISTORY, LEAST_HISTORY = 15, 3  # frames whose changes are the usual one, and how many it takes
JUMP = 2.5  # times the usual change between thumbnails: by a zoom of 1.1 and more they change by 4 times and more
FEATURES, CONTRAST = 1500, 0.01  # of SIFT, which finds a wall's faint vessels by so little contrast
RATIO = 0.8
# Of the features of two frames, those that one similarity maps to this share of the width, and what a zoom's has: a
# factor, no turn, and, as a share of the width, a middle that stays. Chosen on a real colonoscopy of 1,800 frames
# (realclips/gastrolab_normal): of its own frames none has a factor of 1.06 and more by these; zooms of 1.2 to 2 put in
# at ten places have 58 to 97 % inliers at nine of them. The rest, in quick motion or on bare wall, is not found.
INLIER_SHARE, LEAST_INLIERS, LEAST_SHARE = 0.005, 25, 0.55
LEAST_FACTOR, MOST_TURN_DEG, MOST_SHIFT = 1.08, 1.5, 0.02
SAME = 0.06  # between the logarithms of two factors that are one

OTHER: Verdict = "other layout"

Grey = NDArray[np.uint8]
LookedAt = tuple[int, float, str]  # number of a frame, seconds, verdict


class DigitalZoom:
    """Fed the used frames of a film in their order."""

    def __init__(self, content: NDArray[np.uint8]) -> None:
        """content: mask (H,W) of the picture in working frames."""
        around = 2 * round(0.01 * content.shape[1]) + 1
        self._inside = cv2.erode(content, np.ones((around, around), np.uint8), borderValue=0)
        self._changes: deque[float] = deque(maxlen=HISTORY)
        self._last: tuple[Grey, NDArray[np.float32]] | None = None
        self._levels = [0.0]  # logarithm of the factor over the first frame's
        self._level: list[int] = []  # of each frame
        self._frames: list[int] = []

    def remember(self, rgb: NDArray[np.uint8], frame: int) -> None:
        """The next used frame (H,W,3) and its number."""
        grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
        thumbnail = cv2.resize(grey, THUMBNAIL, interpolation=cv2.INTER_AREA).astype(np.float32)
        level = self._level[-1] if self._level else 0
        if self._last is not None:
            change = float(np.abs(thumbnail - self._last[1]).mean())
            if len(self._changes) >= LEAST_HISTORY and change > JUMP * np.median(self._changes):
                level = self._level_at(level, zoom_between(self._last[0], grey, self._inside))
            self._changes.append(change)
        self._last = grey, thumbnail
        self._level.append(level)
        self._frames.append(frame)

    def _level_at(self, before: int, factor: float) -> int:
        """Number of the level after a change by this factor; a level that was there before counts as the same."""
        if factor == 1.0:
            return before
        wanted = self._levels[before] + np.log(factor)
        off = np.abs(np.array(self._levels) - wanted)
        if off.min() < SAME:
            return int(off.argmin())
        self._levels.append(float(wanted))
        return len(self._levels) - 1

    def judged(self, looked_at: list[LookedAt], notes: list[str]) -> list[LookedAt]:
        """The same, but that those are of another layout that are shown at another zoom than most; of two zooms with as
        many, than the first. `notes` gets what a person is told."""
        if len(self._levels) == 1:
            return looked_at
        kept = int(np.bincount(self._level).argmax())
        out = {frame for frame, level in zip(self._frames, self._level, strict=True) if level != kept}
        factors = np.exp(np.array([self._levels[n] for n in sorted({*self._level} - {kept})]) - self._levels[kept])
        seconds = [at for frame, at, _ in looked_at if frame in out]
        notes.append(_told(len(out), seconds[0], seconds[-1], sorted(factors)))
        return [(frame, at, OTHER if frame in out else verdict) for frame, at, verdict in looked_at]


def _told(count: int, first: float, last: float, factors: list[float]) -> str:
    larger = " and ".join(f"{factor:.2g}" for factor in factors)
    enlarged = "" if factors[0] > 1 else "; a camera file of the whole picture is wrong for the others"
    return (
        f"{count} of the frames between {first:.1f} and {last:.1f} s are shown {larger} times as large as the "
        "others, all of the picture at once, as by a processor's digital zoom, which makes another lens; they were "
        f"left out, and --start and --end make a run of their own of such a part{enlarged}"
    )


def zoom_between(before: Grey, after: Grey, inside: NDArray[np.uint8]) -> float:
    """Factor by which the picture (H,W) grew from one frame to the next; 1 where it is not shown enlarged."""
    sift = cv2.SIFT.create(FEATURES, contrastThreshold=CONTRAST)
    (points, descriptors), (others, of_others) = (sift.detectAndCompute(grey, inside) for grey in (before, after))
    if min(len(points), len(others)) < LEAST_INLIERS:
        return 1.0
    pairs = cv2.BFMatcher().knnMatch(descriptors, of_others, k=2)
    good = [one for one, second in pairs if one.distance < RATIO * second.distance]
    if len(good) < LEAST_INLIERS:
        return 1.0
    moved_from = np.array([points[one.queryIdx].pt for one in good])
    moved_to = np.array([others[one.trainIdx].pt for one in good])
    cv2.setRNGSeed(0)
    most_px = INLIER_SHARE * before.shape[1]
    found, inliers = cv2.estimateAffinePartial2D(moved_from, moved_to, ransacReprojThreshold=most_px)
    if found is None or inliers.sum() < max(LEAST_INLIERS, LEAST_SHARE * len(good)):
        return 1.0
    factor, turn = float(np.hypot(*found[:, 0])), float(np.degrees(np.arctan2(found[1, 0], found[0, 0])))
    middle = np.array(before.shape[::-1]) / 2
    shift = float(np.linalg.norm(found[:, :2] @ middle + found[:, 2] - middle)) / before.shape[1]
    is_zoom = max(factor, 1 / factor) >= LEAST_FACTOR and abs(turn) <= MOST_TURN_DEG and shift <= MOST_SHIFT
    return factor if is_zoom else 1.0
