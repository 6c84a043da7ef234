"""A film of a stereo endoscope as a source: its frames are the rectified left eye's, each with metric depth."""

from collections.abc import Iterator
from itertools import islice
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
        others = iter(()) if self._right is None else iter(self._right)
        for frame in super().__iter__():
            if self._right is None:
                left, right = split(frame.rgb, self._layout)
            else:
                other = next(others, None)
                if other is None:
                    self._note(f"{self._right.path.name} ends earlier: frames from {frame.index} on were left out")
                    return
                left, right = frame.rgb, other.rgb
            if left.shape != right.shape:
                raise HaustraError(
                    f"the two eyes have pictures of other sizes: {left.shape[1::-1]}, {right.shape[1::-1]}"
                )
            self._rig = self._rig or rectify(self._calibration, (left.shape[1], left.shape[0]))
            self._pair = self._rig.rectified(left, right)
            yield RawFrame(frame.index, frame.seconds, self._pair[0])

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
