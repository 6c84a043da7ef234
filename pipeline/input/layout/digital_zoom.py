"""Parts of a film in which the processor shows a cut-out of its picture enlarged: another lens within the same outline.

From one frame to the next all of the picture then grows by one factor about its middle, whatever the depth, and stays
so. Of a scope that moves forward near wall grows more than far wall, and it moves in the frames around as well.
"""

from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.text import first_few
from pipeline.input.frame_quality import Verdict, thumbnail

OTHER_ZOOM: Verdict = "other zoom"
HISTORY, LEAST_HISTORY = 15, 3  # frames whose changes are the usual one, and how many it takes
JUMP = 2.5  # times the usual change between thumbnails: by a zoom of 1.2 and more they change by 4 times and more
MOST_GAP = 2.0  # times the usual step between the numbers of used frames
FEATURES, CONTRAST = 1500, 0.01  # of SIFT, which finds a wall's faint vessels by so little contrast
RATIO = 0.8
# Of the features of two frames, those that one similarity maps to this share of the width, and what a zoom's has: a
# factor, no turn, and, as a share of the width, a middle that stays. Chosen on a real colonoscopy of 1,800 frames
# (realclips/gastrolab_normal), of which none has a factor of 1.06 and more by these. Of zooms put into it about half
# are found; the others begin in quick motion or on bare wall.
INLIER_SHARE, LEAST_INLIERS, LEAST_SHARE = 0.005, 25, 0.55
LEAST_FACTOR, MOST_TURN_DEG, MOST_SHIFT = 1.15, 1.5, 0.02
SAME = 0.06  # between the logarithms of two factors that are one

Grey = NDArray[np.uint8]
LookedAt = tuple[int, float, str]  # number of a frame, seconds, verdict


@dataclass(frozen=True)
class _Change:
    """At a frame's place in the order in which the used ones came, the logarithm of the factor of its zoom over the one
    before."""

    place: int
    log_factor: float


class DigitalZoom:
    """Fed the used frames of a film in their order."""

    def __init__(self, content: NDArray[np.uint8]) -> None:
        """content: mask (H,W) of the picture in working frames."""
        around = 2 * round(0.01 * content.shape[1]) + 1
        self._inside = cv2.erode(content, np.ones((around, around), np.uint8), borderValue=0)
        self._usual: deque[float] = deque(maxlen=HISTORY)  # changes between thumbnails
        self._steps: deque[int] = deque(maxlen=HISTORY)  # between numbers of frames
        self._last: tuple[Grey, NDArray[np.float32]] | None = None
        self._frames: list[int] = []
        self._changes: list[_Change] = []
        self._pending: _Change | None = None  # of the latest frame; it counts if the next one goes on as usual

    def remember(self, rgb: NDArray[np.uint8], frame: int) -> None:
        """The next used frame (H,W,3) and its number."""
        grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
        small = thumbnail(grey)
        if self._last is not None:
            before, small_before = self._last
            change, step = float(np.abs(small - small_before).mean()), frame - self._frames[-1]
            known = len(self._usual) >= LEAST_HISTORY
            has_jumped = known and change > JUMP * np.median(self._usual)
            if self._pending is not None and not has_jumped:
                self._changes.append(self._pending)
            self._pending = None
            if has_jumped and step <= MOST_GAP * np.median(self._steps):
                log_factor = float(np.log(zoom_between(before, grey, self._inside)))
                self._pending = _Change(len(self._frames), log_factor) if log_factor else None
            if not has_jumped:
                self._usual.append(change)
            self._steps.append(step)
        self._last = grey, small
        self._frames.append(frame)

    def judged(self, looked_at: list[LookedAt], notes: list[str]) -> list[LookedAt]:
        """The same, but that frames between a change of the zoom and the change back are of another zoom; not where
        they are the most. `notes` gets what a person is told of these, and of changes that nothing takes back, which
        may have had their other end where the wall shows too little."""
        between, open_ends = self._paired()
        out = {self._frames[place] for begin, end, _ in between for place in range(begin, end)}
        seconds = {frame: at for frame, at, _ in looked_at}
        if 2 * len(out) > len(self._frames):
            out, open_ends = set(), [_Change(begin, factor) for begin, _, factor in between] + open_ends
        if out:
            factors = sorted(float(np.exp(factor)) for _, _, factor in between)
            notes.append(_told(len(out), seconds[min(out)], seconds[max(out)], factors))
        if open_ends:
            notes.append(_doubted([(seconds[self._frames[one.place]], np.exp(one.log_factor)) for one in open_ends]))
        return [(frame, at, OTHER_ZOOM if frame in out else verdict) for frame, at, verdict in looked_at]

    def _paired(self) -> tuple[list[tuple[int, int, float]], list[_Change]]:
        """Stretches of another zoom, by their first place, the one after their last, and the logarithm of the factor at
        their beginning; and changes that no later ones undo."""
        between: list[tuple[int, int, float]] = []
        still_open: list[_Change] = []
        for change in self._changes:
            back = change.log_factor
            for number in range(len(still_open) - 1, -1, -1):
                back += still_open[number].log_factor
                if abs(back) < SAME:
                    first = still_open[number]
                    between = [one for one in between if one[0] < first.place]  # shorter ones within
                    between.append((first.place, change.place, first.log_factor))
                    del still_open[number:]
                    break
            else:
                still_open.append(change)
        return between, still_open


def _told(count: int, first: float, last: float, factors: list[float]) -> str:
    larger = " and ".join(dict.fromkeys(f"{factor:.2g}" for factor in factors))
    return (
        f"{count} of the frames between {first:.1f} and {last:.1f} s are shown {larger} times as large as those before "
        "and after, all of the picture at once, as by a processor's digital zoom, which makes another lens; they were "
        "left out, and --start and --end make a run of their own of such a part"
    )


def _doubted(changes: list[tuple[float, float]]) -> str:
    """changes: seconds, and the factor by which the picture grew there."""
    zooms = [f"{factor:.2g} times as large from {at:.1f} s on" for at, factor in changes]
    return (
        f"the picture may be shown at several zooms ({first_few(zooms)}): the lens would be another there, and what is "
        "built of both wrong; make a run of each part by --start and --end"
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
