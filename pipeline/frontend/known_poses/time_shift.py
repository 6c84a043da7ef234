"""Poses that are right, each at another frame than its own: how many frames they are late or early, by the pictures.

The distance of matched features from their epipolar lines is 0.2 to 0.5 px with exact poses, and grows with each frame
that they are off, as the camera's motion changes: by a pixel on an uneven film, by a tenth of one on an even one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from haustra.core.ray_table import RayTable
from haustra.core.se3 import Array
from haustra.core.text import counted
from pipeline.frontend.known_poses.epipolar_lines import MatchedPair, inliers, matched_pairs, off_line_px
from pipeline.matching.sift import FindFeatures

MOST_FRAMES = 30  # a second; farther, the film is another one
BETTER = 0.6  # a shift must lower the distance to this part of it
LEAST_GAIN_PX = 0.3  # and by so much: less does no harm
ALIKE = 1.2  # times the least distance: with rough poses the shifts beside the right one fit as well
LEAST_PAIRS, LEAST_SHARE = 4, 0.5  # of the pairs: so many have a pose for both frames after the shift
FITS = 0.8  # share of inliers after the shift; exact poses have 0.74 to 0.95, those of another path by chance 0.6


@dataclass(frozen=True)
class TimeShift:
    """frames: by which the poses are late, negative: early. px, given_px: median distance of the matches from their
    epipolar lines with and without the shift. others: shifts of the same sign that fit nearly as well."""

    frames: int
    px: float
    given_px: float
    others: tuple[int, ...] = ()

    def sentence(self, path: Path, seconds_apart: float | None) -> str:
        """One sentence; seconds_apart: between two frames, where the poses have times."""
        many, (wrong, right) = abs(self.frames), (max(self.frames, 0), max(-self.frames, 0))
        verb, word = ("take", "from") if self.frames > 0 else ("add", "to")
        advice = (
            f"{verb} {many} {word} the number of each pose: that of frame {wrong} is of frame {right}"
            if seconds_apart is None
            else f"{verb} {many * seconds_apart:.3f} s {word} each pose's time"
        )
        return (
            f"the poses of {path} are {self._many()} {'late' if self.frames > 0 else 'early'}: so shifted, "
            f"matches lie {self.px:.2g} px off their epipolar lines in the median instead of {self.given_px:.2g}; "
            f"{advice}"
        )

    def _many(self) -> str:
        alike = sorted(abs(frames) for frames in (self.frames, *self.others))
        return counted(alike[0], "frame") if alike[0] == alike[-1] else f"{alike[0]} to {alike[-1]} frames"


def find_shift(
    frames: Sequence[int], world_from_camera: Array, pairs: list[MatchedPair], focal_px: float
) -> TimeShift | None:
    """The shift of world_from_camera (N,4,4), given for frames, that fits the matches clearly better than none."""
    row_of, found = {frame: row for row, frame in enumerate(frames)}, []
    for shift in (number for number in range(-MOST_FRAMES, MOST_FRAMES + 1) if number != 0):
        rows = [[row_of.get(frames[row] + shift, -1) for row in pair.rows] for pair in pairs]
        posed = [
            (pair, (first, second)) for pair, (first, second) in zip(pairs, rows, strict=True) if first >= 0 <= second
        ]
        if len(posed) < max(LEAST_PAIRS, LEAST_SHARE * len(pairs)):
            continue
        moved = [replace(pair, rows=both) for pair, both in posed]
        given_px = _median_px([pair for pair, _ in posed], world_from_camera, focal_px)
        px = _median_px(moved, world_from_camera, focal_px)
        if px < min(BETTER * given_px, given_px - LEAST_GAIN_PX):
            good = np.concatenate([inliers(pair, world_from_camera, focal_px)[0] for pair in moved])
            if good.mean() >= FITS:
                found.append(TimeShift(shift, px, given_px))
    best = min(found, key=lambda shift: (shift.px, abs(shift.frames)), default=None)
    if best is None:
        return None
    alike = [shift.frames for shift in found if shift.px < ALIKE * best.px and shift.frames * best.frames > 0]
    return replace(best, others=tuple(alike))


def first_by_pictures(
    readings: Mapping[int, Mapping[int, Array]], used: NDArray[np.int64], rays: RayTable, find: FindFeatures
) -> int:
    """The number that a film's first frame has in a file: of the readings by that number, each of poses by frame, the
    one with matches nearest to their epipolar lines; the first of them where no two frames match."""
    likeliest = next(iter(readings))
    if len(readings) == 1:
        return likeliest
    frames = [frame for frame in used.tolist() if all(frame in reading for reading in readings.values())]
    pairs = matched_pairs(frames, rays, find)

    def off_px(first: int) -> float:
        return _median_px(pairs, np.stack([readings[first][frame] for frame in frames]), rays.focal_px)

    return min(readings, key=off_px) if pairs else likeliest


def _median_px(pairs: list[MatchedPair], world_from_camera: Array, focal_px: float) -> float:
    return float(np.median(np.concatenate([off_line_px(pair, world_from_camera, focal_px) for pair in pairs])))
