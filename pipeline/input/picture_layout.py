"""Where the processor puts the picture on the screen, and parts of a film in which it puts it elsewhere.

The content area, and with it the lens, is found once for a film. A processor that shows the picture larger, smaller or
at another place for a while would give that part a wrong lens without a word.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.input.burned_in_text import BORDER_LEVEL
from pipeline.input.content_area import ContentArea

LOOKED_AT = 160  # px, longer side
LIT = 2 * BORDER_LEVEL  # grey level that no black border reaches
LEAST_BORDER, MOST_LIT = 0.05, 0.3  # shares: of the frame, that is border at all; of the border, lit by clock and name
WINDOW = 50  # frames in which a moving view has lit all of the picture's outline
SMALLER = 0.6  # of the content's area: a picture below this is shown smaller; the walls reach the rim everywhere


class PictureLayout:
    """Fed a film's frames in their order. `notes`: what was found so far, a sentence each."""

    def __init__(self, area: ContentArea) -> None:
        height, width = area.mask.shape
        self._step = max(1, round(max(height, width) / LOOKED_AT))
        self._inside = self._thinned(area.mask) > 0
        shown = cv2.dilate(self._thinned(np.maximum(area.mask, area.lit)), np.ones((3, 3), np.uint8))
        self._border = shown == 0
        self._brightest = np.zeros(self._inside.shape, np.uint8)  # over the window's frames
        self._window: list[float] = []  # their seconds
        self._elsewhere: list[float] = []
        self._smaller: list[tuple[float, float, float]] = []  # first and last second, share of the content

    def _thinned(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        return np.ascontiguousarray(image[:: self._step, :: self._step])

    def is_elsewhere(self, rgb: NDArray[np.uint8], seconds: float) -> bool:
        """Whether a frame (H,W,3) shows something where the others have their black border."""
        brightest = np.maximum.reduce(cv2.split(self._thinned(rgb)))
        if self._border.mean() > LEAST_BORDER and (brightest[self._border] > LIT).mean() > MOST_LIT:
            self._elsewhere.append(seconds)
            return True
        np.maximum(self._brightest, brightest, out=self._brightest)
        self._window.append(seconds)
        if len(self._window) == WINDOW:
            self._judge_window()
        return False

    def _judge_window(self) -> None:
        lit = ((self._brightest > BORDER_LEVEL) & self._inside).astype(np.uint8)
        outlines, _ = cv2.findContours(lit, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        if outlines:
            hull = cv2.convexHull(max(outlines, key=cv2.contourArea))
            share = np.count_nonzero(cv2.fillConvexPoly(np.zeros_like(lit), hull, 1)) / np.count_nonzero(self._inside)
            if share < SMALLER:
                self._smaller.append((self._window[0], self._window[-1], float(share)))
        self._brightest[:], self._window = 0, []

    @property
    def notes(self) -> list[str]:
        found = []
        if self._elsewhere:
            count, first, last = len(self._elsewhere), self._elsewhere[0], self._elsewhere[-1]
            found.append(
                f"{count} of the frames between {first:.1f} and {last:.1f} s show something where the film has its "
                "black border, as when the processor changes its layout or a title is shown; they were left out, and "
                "--start and --end make a run of their own of such a part"
            )
        if self._smaller:
            first, last = self._smaller[0][0], self._smaller[-1][1]
            share = float(np.median([share for _, _, share in self._smaller]))
            found.append(
                f"between {first:.1f} and {last:.1f} s frames are lit on {100 * share:.0f} % of the picture alone, as "
                "when the processor shows it smaller: there the lens is another, and what is built of them is wrong; "
                "leave them out with --start or --end"
            )
        return found
