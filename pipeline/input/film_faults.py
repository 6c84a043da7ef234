"""What a film's frames say of how it was taken: rows of two times that no flag announces, colours of three times.

Both show where the camera moves, and nowhere else: frames are looked at until enough of them moved.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

MOVING_FRAMES, FEWEST_MOVING = 12, 4  # looked at, and fewer tell nothing
MOST_FRAMES = 1500  # decoded to find them: a title may stand for a while
MOVED = 1.5  # grey levels, mean, between thumbnails
COMBED_ROWS = 1.1  # `row_change`; films without combs: 0.3 to 0.6, noise alone: 1
LEAST_COMB = 2.5  # grey levels, mean, of rows off their neighbours; banding and rows of unlike gain stay below
WHOLE_ROWS = 0.8  # a frame of an interlaced film below this shows one time: nothing moved
COMBED_FRAMES = 0.25  # share of the moving frames: what moves along the rows alone is combed little
FRINGE_PX = 0.5  # median; films whose colours are of one time: up to 0.2
CLEAR_PEAK = 0.1  # of the correlation of two colours; less, and they show no common edges


@dataclass(frozen=True)
class FilmFaults:
    """combed: rows alternate between two times; fringe_px: by which red and blue lie apart, 0 where they do not."""

    combed: bool = False
    fringe_px: float = 0.0

    @property
    def notes(self) -> list[str]:
        found = []
        if self.combed:
            found.append(
                "the film is interlaced though no flag says so (every other row is of another time): where it moves "
                "the upper field was taken, at half the height's detail"
            )
        if self.fringe_px:
            found.append(
                f"red and blue lie {self.fringe_px:.1f} px apart where the camera moves, as of a processor that lights "
                "one colour after the other: edges are that uncertain, so move slowly, or record without that mode"
            )
        return found


def look_at(frames: Iterable[NDArray[np.uint8]]) -> FilmFaults:
    """Faults of a film's frames (H,W,3) uint8 RGB as stored, in their order; none where hardly anything moves."""
    combs: list[bool] = []
    still: list[bool] = []  # rows that differ in a picture that stands are of the sensor, not of two times
    fringes: list[float] = []
    last: NDArray[np.float32] | None = None
    for count, rgb in enumerate(frames):
        if count >= MOST_FRAMES or len(combs) >= MOVING_FRAMES:
            break
        thumbnail = cv2.resize(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), (32, 32), interpolation=cv2.INTER_AREA)
        now = thumbnail.astype(np.float32)
        if last is not None and np.abs(now - last).mean() < MOVED:
            if len(still) < MOVING_FRAMES:
                still.append(row_change(rgb) > COMBED_ROWS)
            continue
        if last is not None:
            combs.append(row_change(rgb) > COMBED_ROWS)
            fringes.append(colour_shift(rgb))
        last = now
    if len(combs) < FEWEST_MOVING:
        return FilmFaults()
    fringe = float(np.median(fringes))
    combed = bool(np.mean(combs) >= COMBED_FRAMES) and not (still and np.mean(still) >= COMBED_FRAMES)
    return FilmFaults(combed, fringe if fringe >= FRINGE_PX else 0.0)


def row_change(rgb: NDArray[np.uint8]) -> float:
    """How far rows lie off the mean of their neighbours, over how far off the mean of the rows two away: below 1 for a
    picture of one time, whose rows differ the more the farther they lie apart; above 1 where every other row is of
    another time. 0 where rows differ too little to tell."""
    grey = cv2.blur(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float32), (5, 1))
    rows = grey[2:-2]
    near = np.abs(rows - (grey[1:-3] + grey[3:-1]) / 2).sum()
    far = np.abs(rows - (grey[:-4] + grey[4:]) / 2).sum()
    return float(near / far) if near > LEAST_COMB * rows.size else 0.0


def colour_shift(rgb: NDArray[np.uint8]) -> float:
    """Pixels by which the edges in blue lie off those in red, by phase correlation; 0 where they share too little.

    Edges whose colours a lens spreads lie off to all sides, and cancel.
    """
    height, width = (_unpadded(side) for side in rgb.shape[:2])
    red, blue = (
        cv2.Laplacian(cv2.GaussianBlur(rgb[:height, :width, channel].astype(np.float32), (0, 0), 1.5), cv2.CV_32F)
        for channel in (0, 2)
    )
    window = cv2.createHanningWindow((width, height), cv2.CV_32F)
    (x, y), peak = cv2.phaseCorrelate(red, blue, window)
    return float(np.hypot(x, y)) if peak > CLEAR_PEAK else 0.0


def _unpadded(side: int) -> int:
    """The longest part of a side that OpenCV transforms as it is, of even length: of an odd one, to which it may pad
    an even side, too, the shift is off by half a pixel."""
    return next((n for n in range(side - side % 2, 1, -2) if cv2.getOptimalDFTSize(n) == n), side)
