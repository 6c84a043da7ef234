"""Text that a video processor burns into its images: date, time with a frame counter, a name. All invented.

Text hides the wall, so that no truth is given under it; it tests methods that would take it for texture.
"""

from __future__ import annotations

import re
from datetime import datetime, timedelta

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
FONT = cv2.FONT_HERSHEY_PLAIN
CAPITAL_PX = 10.0  # height of a capital letter of this font at scale 1
LETTER = 0.024  # letter height over image width: 8 px at 320 px
LINE = 1.5  # line spacing in letter heights
INKS = ((0.95, 0.95, 0.95), (0.35, 0.95, 0.45))  # processors write white or green
OUTLINE = 0.25  # factor on the image just around a letter, so that white can be read on a glint


class Overlay:
    """Three lines of text in the upper left corner. The seed fixes date, hour and colour."""

    def __init__(self, width: int, height: int, seed: int, fps: float = 30.0) -> None:
        rng = np.random.default_rng([seed, 6])
        self._shape, self._fps, self._name = (height, width), fps, f"PHANTOM {seed % 10_000}"
        self._ink = np.array(INKS[rng.integers(len(INKS))], np.float32)
        self._start = datetime(2031, 1, 1) + timedelta(seconds=int(rng.integers(365 * 86_400)))
        self._letter_px = max(LETTER * width, 3.0)

    def lines(self, count: int) -> list[str]:
        """The lines of text of frame `count`."""
        now = self._start + timedelta(seconds=count / self._fps)
        counter = count % round(self._fps)
        return [now.strftime("%d/%m/%Y"), f"{now:%H:%M:%S}:{counter:02d}", self._name]

    def area(self) -> NDArray[np.bool_]:
        """True (H,W) on the lines' bounding boxes with the widest digits, the same for every frame."""
        hidden = np.zeros(self._shape, bool)
        for index, line in enumerate(self.lines(0)):
            widest = re.sub(r"\d", "8", line)
            written = self._write([""] * index + [widest])
            rows, columns = np.nonzero(_around(written))
            if len(rows):
                hidden[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1] = True
        return hidden

    def draw(self, encoded: Floats, count: int, area: NDArray[np.bool_]) -> None:
        """Draw frame `count`'s lines on an encoded image (H,W,3) in place, within `area` (H,W)."""
        left, top, width, height = cv2.boundingRect(area.view(np.uint8))
        box = np.s_[top : top + height, left : left + width]
        written = self._write(self.lines(count))
        letters, shade = (
            np.where(area[box], sheet[box], 0)[..., None].astype(np.float32) / 255
            for sheet in (written, _around(written))
        )
        picture = encoded[box]
        picture *= 1 - (1 - OUTLINE) * shade
        picture += letters * (self._ink - picture)

    def _write(self, lines: list[str]) -> NDArray[np.uint8]:
        """Coverage (H,W) 0 to 255 of lines of text in the upper left corner."""
        sheet = np.zeros(self._shape, np.uint8)
        for index, line in enumerate(lines):
            place = (round(0.8 * self._letter_px), round((1.6 + LINE * index) * self._letter_px))
            cv2.putText(sheet, line, place, FONT, self._letter_px / CAPITAL_PX, 255, 1, cv2.LINE_AA)
        return sheet


def _around(written: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Coverage (H,W) of the letters dilated by one pixel."""
    return cv2.dilate(written, np.ones((3, 3), np.uint8))
