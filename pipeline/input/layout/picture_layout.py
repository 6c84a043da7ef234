"""Where the processor puts the picture on the screen, and parts of a film in which it puts it elsewhere.

The content area, and with it the lens, is found once for a film. A processor that shows the picture larger, smaller or
at another place for a while would give that part a wrong lens without a word. An inset beside the picture changes
nothing, and neither does light that comes to a part of the picture that was dark when the area was found.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.text import first_few
from pipeline.input.burned_in_text import BORDER_LEVEL
from pipeline.input.content_area import ContentArea

LOOKED_AT = 160  # px, longer side
LIT = 2 * BORDER_LEVEL  # grey level that no black border reaches
LEAST_BORDER, MOST_LIT = 0.03, 0.3  # shares: of the frame, that is border at all; of the border, lit by clock and name
MOST_RIM_LIT = 0.5  # of what lies next to the picture: more is lit where the picture is larger, not by an inset
LEAST_SHOWN = 0.3  # of the content's place: less is lit where the picture has gone
WINDOW = 50  # used frames in which a moving view has lit all of the picture's outline
SMALLER = (0.1, 0.6)  # of the content's area: a picture in between is shown smaller
BLACK = 12  # grey level of a border, at most; dark tissue has noise
SAME_OUTLINE = 0.95  # of two windows' outlines, intersection over union

Mask = NDArray[np.uint8]


class PictureLayout:
    """Fed a film's frames in their order. `notes`: what was found so far, a sentence each."""

    def __init__(self, area: ContentArea) -> None:
        height, width = area.mask.shape
        self._step = max(1, round(max(height, width) / LOOKED_AT))
        self._inside = self._thinned(area.mask) > 0
        shown = cv2.dilate(self._thinned(np.maximum(area.mask, area.lit)), np.ones((3, 3), np.uint8))
        self._border = shown == 0
        self._rim = self._border & (cv2.dilate(shown, np.ones((7, 7), np.uint8)) > 0)
        self._latest = self._brightest = np.zeros(self._inside.shape, np.uint8)  # a frame's; the window's
        self._window: list[float] = []  # seconds of its frames
        self._outline: Mask | None = None  # of the window before, where it was smaller
        self._elsewhere: list[float] = []
        self._smaller: list[tuple[float, float, float]] = []  # first and last second, share of the content

    def _thinned(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        return np.ascontiguousarray(image[:: self._step, :: self._step])

    def is_elsewhere(self, rgb: NDArray[np.uint8], seconds: float) -> bool:
        """Whether a frame (H,W,3) has its picture where the others have their black border."""
        self._latest = np.maximum.reduce(cv2.split(self._thinned(rgb)))
        if self._border.mean() < LEAST_BORDER or (self._latest[self._border] > LIT).mean() < MOST_LIT:
            return False
        is_larger = (self._latest[self._rim] > LIT).mean() > MOST_RIM_LIT
        has_gone = (self._latest[self._inside] > BORDER_LEVEL).mean() < LEAST_SHOWN
        if is_larger or has_gone:
            self._elsewhere.append(seconds)
        return bool(is_larger or has_gone)

    def remember(self, seconds: float) -> None:
        """That the frame that was asked about last is used: a window of such frames tells a smaller picture."""
        self._brightest = np.maximum(self._brightest, self._latest)
        self._window.append(seconds)
        if len(self._window) < WINDOW:
            return
        outline, share = self._outline_of(self._brightest)
        is_smaller = SMALLER[0] < share < SMALLER[1] and self._is_black_around(outline)
        if is_smaller and self._outline is not None and _overlap(outline, self._outline) > SAME_OUTLINE:
            self._smaller.append((self._window[0], self._window[-1], share))
        self._outline = outline if is_smaller else None
        self._brightest, self._window = np.zeros_like(self._brightest), []

    def _outline_of(self, brightest: NDArray[np.uint8]) -> tuple[Mask, float]:
        """Hull (H,W) of the largest part that is lit, and its share of the content."""
        lit = ((brightest > BORDER_LEVEL) & self._inside).astype(np.uint8)
        outlines, _ = cv2.findContours(lit, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        hull = np.zeros_like(lit)
        if outlines:
            cv2.fillConvexPoly(hull, cv2.convexHull(max(outlines, key=cv2.contourArea)), 1)
        return hull, float(hull.sum() / max(int(self._inside.sum()), 1))

    def _is_black_around(self, outline: Mask) -> bool:
        around = self._inside & (cv2.dilate(outline, np.ones((5, 5), np.uint8)) == 0)
        return bool(around.any() and np.percentile(self._brightest[around], 95) <= BLACK)

    @property
    def notes(self) -> list[str]:
        found = []
        if self._elsewhere:
            count, first, last = len(self._elsewhere), self._elsewhere[0], self._elsewhere[-1]
            found.append(
                f"{count} of the frames between {first:.1f} and {last:.1f} s have their picture where the film has its "
                "black border, as when the processor changes its layout or a title is shown; they were left out, and "
                "--start and --end make a run of their own of such a part"
            )
        if self._smaller:
            spans = [f"{first:.1f} to {last:.1f} s" for first, last, _ in self._smaller]
            share = float(np.median([share for _, _, share in self._smaller]))
            found.append(
                f"the picture may be shown smaller for a while ({first_few(spans)}: {100 * share:.0f} % of its place "
                "is lit, the rest black): there the lens would be another, and what is built of such frames wrong; "
                "leave them out with --start or --end"
            )
        return found


def _overlap(one: Mask, other: Mask) -> float:
    return float((one & other).sum() / max(int((one | other).sum()), 1))
