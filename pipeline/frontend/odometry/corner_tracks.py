"""Tracks: corners tracked from a reference frame, each with a number that never comes back.

Each frame is compared with the reference image, not with the frame before it, so that errors of tracking add up per
reference frame and a single bad frame costs nothing. The reference moves on when the view has changed.
"""

import math

import numpy as np
from numpy.typing import NDArray

from pipeline.frontend.odometry.klt import Pixels, TrackerImage, detect, in_whole_cells, track_klt

CELLS = 484  # about, where windows fit: one track in each; a square of 320 px has so many, of 14 px
LEAST_CELL_PX, LEAST_CELL_SHARE = 6, 0.7  # and of the side by which the whole picture would have so many


class CornerTracks:
    """ids (N,); reference_pixels (N,2); now (N,2) last known; found (N,) in the latest frame."""

    def __init__(self) -> None:
        self.ids: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self.reference_pixels: Pixels = np.zeros((0, 2), dtype=np.float32)
        self.now: Pixels = self.reference_pixels
        self.found: NDArray[np.bool_] = np.zeros(0, dtype=bool)
        self.reference: TrackerImage | None = None
        self.count = 0  # tracks ever begun

    def follow(self, view: TrackerImage, guess: Pixels | None = None) -> None:
        """Look for every track in `view`; `guess` (N,2) where the motion says that it is, NaN = not known."""
        if self.reference is None:
            return
        start = self.now if guess is None else np.where(np.isfinite(guess), guess, self.now).astype(np.float32)
        now, self.found = track_klt(self.reference, view, self.reference_pixels, start, near=guess is not None)
        lost = ~self.found
        if guess is not None and lost.any():  # those for which the guess was wrong: near points, in a sudden motion
            now[lost], self.found[lost] = track_klt(self.reference, view, self.reference_pixels[lost], start[lost])
        self.now = np.where(self.found[:, None], now, self.now)

    def keep(self, mask: NDArray[np.bool_]) -> None:
        """Only the tracks of the mask stay."""
        self.ids, self.reference_pixels, self.now = self.ids[mask], self.reference_pixels[mask], self.now[mask]
        self.found = self.found[mask]

    def set_reference(self, view: TrackerImage) -> None:
        """Make `view`, which `follow` was just given, the reference frame; fill empty places with new tracks."""
        self.keep(self.found)
        added = detect(view, self.now, cell_side(view.mask))
        fresh = np.arange(self.count, self.count + len(added))
        self.count += len(added)
        self.ids = np.concatenate([self.ids, fresh])
        self.now = self.reference_pixels = np.concatenate([self.now, added])
        self.found = np.ones(len(self.ids), dtype=bool)
        self.reference = view

    def motion_px(self) -> float:
        """Median way from the reference frame of the tracks that were found."""
        if not self.found.any():
            return 0.0
        return float(np.median(np.linalg.norm((self.now - self.reference_pixels)[self.found], axis=1)))

    def found_share(self) -> float:
        """Share of the reference's tracks that were found."""
        return float(self.found.mean()) if len(self.found) else 0.0


def cell_side(mask: NDArray[np.uint8]) -> int:
    """Side, px, of the cells of which as near as may be to `CELLS` have some of the mask in them, so that a wide or cut
    picture is tracked by as many corners as one that fills a square; but no narrower than a share of those that the
    whole picture would have: what glare leaves of it is not crowded."""
    whole = math.sqrt(mask.size / CELLS)
    least = max(LEAST_CELL_PX, round(LEAST_CELL_SHARE * whole))
    sides = range(max(least, math.ceil(whole)), least - 1, -1)
    return min(sides, key=lambda side: abs(math.log(max(_open_cells(mask, side), 1) / CELLS)))


def _open_cells(mask: NDArray[np.uint8], side: int) -> int:
    """Number of cells of the grid of `detect` that have some of the mask in them."""
    padded = in_whole_cells(mask, side)
    rows, columns = padded.shape[0] // side, padded.shape[1] // side
    # One axis after the other: both at once take several times as long, and every keyframe asks.
    bands = padded.reshape(rows, side, columns * side).max(axis=1)
    return int(np.count_nonzero(bands.reshape(rows, columns, side).max(axis=2)))
