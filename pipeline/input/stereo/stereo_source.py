"""A film of a stereo endoscope as a source: its frames are the rectified left eye's, each with metric depth."""

from collections.abc import Iterator
from itertools import chain, islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera
from haustra.core.errors import HaustraError
from pipeline.config import StereoSettings
from pipeline.input.display import lower_field, upper_field
from pipeline.input.stereo.rectified_pair import Picture, RectifiedRig, rectify
from pipeline.input.stereo.rig_file import read_rig
from pipeline.input.video import RawFrame, Source

CHECKED, APART = 6, 12  # pairs that are tested, and frames between two of them
SAME_RATE = 1.1  # of two films' rates; the mean rate of one that lost frames is lower


class StereoSource(Source):
    """Iterating gives the left eye, rectified; `depth_mm` is of the frame that was given last."""

    def __init__(self, path: Path, settings: StereoSettings) -> None:
        super().__init__(path)
        self._layout = settings.layout
        self.rows_are_eyes = settings.layout == "interlaced"
        self._right = None if settings.right is None else Source(Path(settings.right))
        self._calibration = read_rig(Path(settings.calibration or ""))
        self._rig: RectifiedRig | None = None
        self._pair: tuple[Picture, Picture] | None = None

    @property
    def camera(self) -> Camera | None:
        return None if self._rig is None else self._rig.camera

    @property
    def depth_error_per_mm(self) -> float:
        return 0.0 if self._rig is None else self._rig.error_per_mm

    def __iter__(self) -> Iterator[RawFrame]:
        for frame, left, right in self._pairs():
            if left.shape != right.shape:
                raise HaustraError(
                    f"the two eyes have pictures of other sizes: {left.shape[1::-1]}, {right.shape[1::-1]}"
                )
            self._rig = self._rig or rectify(self._calibration, (left.shape[1], left.shape[0]))
            self._pair = self._rig.rectified(left, right)
            yield RawFrame(frame.index, frame.seconds, self._pair[0])

    def _pairs(self) -> Iterator[tuple[RawFrame, Picture, Picture]]:
        """The left eye's frame as it is in its film, and the pictures of both eyes."""
        frames = super().__iter__()
        if self._right is None:
            for frame in frames:
                yield frame, *split(frame.rgb, self._layout)
            return
        try:
            for frame, other in self._of_one_time_in(frames, self._right):
                yield frame, frame.rgb, other.rgb
        finally:
            for sentence in self._right.notes:
                self._note(f"{self._right.path.name}: {sentence}")

    def _of_one_time_in(self, frames: Iterator[RawFrame], right: Source) -> Iterator[tuple[RawFrame, RawFrame]]:
        """Frames of the left film, each with the right film's nearest in time, at most half an interval away: either
        film may have lost some. Of folders, and of films whose rates are not of one camera, by number."""
        others = iter(right)
        other, after, first = next(others, None), next(others, None), next(frames, None)
        by_time = first is not None and self._has_rate_of(right)  # known once both films were begun
        slack = self.step_s / 2 if by_time else 0.5

        def late(one: RawFrame, frame: RawFrame) -> float:
            return one.seconds - frame.seconds if by_time else float(one.index - frame.index)

        for frame in () if first is None else chain((first,), frames):
            while after is not None and other is not None and abs(late(after, frame)) <= abs(late(other, frame)):
                other, after = after, next(others, None)
            if other is None or (after is None and late(other, frame) < -slack):
                self._note(f"{right.path.name} ends earlier: frames from {frame.index} on were left out")
                return
            if abs(late(other, frame)) <= slack:
                yield frame, other
            else:
                self._note(f"frames of {self.path.name} that {right.path.name} has no picture of are left out")

    def _has_rate_of(self, right: Source) -> bool:
        """Whether both are films that say the same rate."""
        steps = sorted((self.step_s, right.step_s))
        if steps[0] == 0 or steps[1] <= SAME_RATE * steps[0]:
            return steps[0] > 0
        left_rate, right_rate = 1 / self.step_s, 1 / right.step_s
        self._note(
            f"the films of the two eyes say {left_rate:.4g} and {right_rate:.4g} frames a second: their frames were "
            "paired by number"
        )
        return False

    def check(self) -> None:
        """Test some pairs: HaustraError where the eyes are swapped, or the calibration is of another rig."""
        pairs = []
        for _ in islice(self, 0, CHECKED * APART, APART):
            if self._pair is not None:
                pairs.append(self._pair)
        if self._rig is not None:
            self._rig.check(pairs)

    def depth_mm(self) -> NDArray[np.float64] | None:
        return None if self._rig is None or self._pair is None else self._rig.depth(*self._pair)


def split(rgb: Picture, layout: str) -> tuple[Picture, Picture]:
    """The left and the right eye (h,w,3) of a picture (H,W,3) that holds both."""
    height, width = rgb.shape[:2]
    if layout == "side-by-side":
        return rgb[:, : width // 2], rgb[:, width // 2 : 2 * (width // 2)]
    if layout == "over-under":
        return rgb[: height // 2], rgb[height // 2 : 2 * (height // 2)]
    return upper_field(rgb), lower_field(rgb)


def open_source(path: Path, settings: StereoSettings) -> Source:
    """A film of one eye, or of two where there is a stereo calibration."""
    return Source(path) if settings.calibration is None else StereoSource(path, settings)
