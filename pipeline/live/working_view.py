"""A live source's frames as the tracker takes them: cut to the content, at working size, judged."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera
from haustra.core.errors import HaustraError
from pipeline.config import FrameSettings
from pipeline.input.calibration import Calibration, calibrate
from pipeline.input.content_area import ContentArea, find_content, has_cut_corners, highlight_mask
from pipeline.input.frame_quality import FrameJudge, Verdict
from pipeline.input.frames import resized, working_scale
from pipeline.input.layout.picture_layout import PictureLayout

LOOKED_AT = 8  # frames from which the content area is found, and
LOOK_EVERY_S = 0.06  # how far they are apart: the run at the end looks at the whole film


@dataclass(frozen=True)
class WorkingFrame:
    """rgb (H,W,3) uint8 and mask (H,W) uint8, nonzero where features may lie, at working size; number in the source."""

    number: int
    seconds: float
    rgb: NDArray[np.uint8]
    mask: NDArray[np.uint8]
    verdict: Verdict


class WorkingView:
    """Where the picture lies in the source's frames, and the camera of what is cut out."""

    def __init__(self, area: ContentArea, calibration: Calibration, settings: FrameSettings) -> None:
        self.area, self.origin = area, calibration.origin
        scale = working_scale(area.box[2:], settings.long_side)
        self.camera: Camera = calibration.camera.cropped_and_scaled(*area.box, scale)
        self.content = resized(area.mask, area, self.camera, cv2.INTER_NEAREST)
        self._judge, self._layout = FrameJudge(), PictureLayout(area)

    def working_frame(self, number: int, seconds: float, rgb: NDArray[np.uint8]) -> WorkingFrame:
        """A frame (h,w,3) of the source."""
        own = resized(rgb, self.area, self.camera, cv2.INTER_AREA)
        mask = np.where(highlight_mask(own) > 0, 0, self.content).astype(np.uint8)
        elsewhere = self._layout.is_elsewhere(rgb, seconds)
        return WorkingFrame(
            number, seconds, own, mask, "other layout" if elsewhere else self._judge.judge(own, self.content)
        )


class ViewFinder:
    """Feed it the first frames; it answers with a `WorkingView` once they show where the picture lies."""

    def __init__(self, choice: str, path: Path, settings: FrameSettings) -> None:
        self.choice, self.path, self.settings = choice, path, settings
        self._looked_at: list[NDArray[np.uint8]] = []
        self._next_s = 0.0

    def look(self, seconds: float, rgb: NDArray[np.uint8]) -> WorkingView | None:
        """None while more is needed, as long as all is black. HaustraError for a camera file of another picture."""
        if self._looked_at and seconds < self._next_s:
            return None
        self._looked_at.append(rgb)
        self._next_s = seconds + LOOK_EVERY_S
        if len(self._looked_at) < LOOKED_AT:
            return None
        try:
            area = find_content(self._looked_at)
        except HaustraError:  # black until now
            self._looked_at = []
            return None
        height, width = rgb.shape[:2]
        cut = has_cut_corners(area)
        found = calibrate(self.choice, self.path, (width, height), area.box, cut)
        return WorkingView(area, found, self.settings)
