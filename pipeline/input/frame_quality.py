"""Is a frame worth tracking? Black, overexposed, red-out, blurred and duplicate frames are named and left out."""

from collections import deque
from dataclasses import dataclass, field
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

Verdict = Literal["used", "black", "overexposed", "no texture", "blurred", "duplicate"]
HISTORY = 15  # frames over which sharpness is compared
MIN_BRIGHTNESS = 8.0  # grey levels; a darker median frame is black
SATURATED, MAX_SATURATED = 250, 0.6  # grey level, and share of pixels at it beyond which nothing is left to see
# Texture is looked for at a scale that the noise of the sensor and the smoothing of a codec leave alone. Red-out has
# 0.7 grey levels there, the smoothest wall that was tracked 2.2 (events_b and loop_b, on which this was chosen).
TEXTURE_SCALE_PX = 3.2
MIN_TEXTURE = 2.0  # grey levels
BORDER_PX = 19  # three scales to each side
MIN_RELATIVE_SHARPNESS = 0.3  # of the running median; a third is motion blur
MIN_CHANGE = 0.35  # grey levels between thumbnails; compression alone gives 0.2


@dataclass
class FrameJudge:
    """Judges frames in order; remembers recent sharpness and the last frame that was used."""

    _sharpness: deque[float] = field(default_factory=lambda: deque(maxlen=HISTORY))
    _last: NDArray[np.float32] | None = None

    def judge(self, rgb: NDArray[np.uint8], content: NDArray[np.uint8]) -> Verdict:
        """rgb (H,W,3) and content mask (H,W), both at working size."""
        inside = content > 0
        brightest = np.maximum.reduce(cv2.split(rgb))[inside]
        if np.median(brightest) < MIN_BRIGHTNESS:
            return "black"
        if (brightest >= SATURATED).mean() > MAX_SATURATED:
            return "overexposed"
        grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
        thumbnail = cv2.resize(grey, (64, 64), interpolation=cv2.INTER_AREA).astype(np.float32)
        if self._last is not None and np.abs(thumbnail - self._last).mean() < MIN_CHANGE:
            return "duplicate"
        if _texture(grey, inside) < MIN_TEXTURE:
            return "no texture"
        sharpness = _sharpness(grey, inside)
        # A running median that only grows from sharp frames would never accept a softer passage: all count.
        self._sharpness.append(sharpness)
        if sharpness < MIN_RELATIVE_SHARPNESS * float(np.median(self._sharpness)):
            return "blurred"
        self._last = thumbnail
        return "used"


def _texture(grey: NDArray[np.uint8], inside: NDArray[np.bool_]) -> float:
    """Spread of the scale-normalised Laplacian of a Gaussian, grey levels, away from the border of the content."""
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), TEXTURE_SCALE_PX)
    response = TEXTURE_SCALE_PX**2 * np.abs(cv2.Laplacian(smooth, cv2.CV_32F))
    away = cv2.erode(inside.astype(np.uint8), np.ones((BORDER_PX, BORDER_PX), np.uint8)) > 0
    return float(np.percentile(response[away if away.any() else inside], 90))


def _sharpness(grey: NDArray[np.uint8], inside: NDArray[np.bool_]) -> float:
    """Spread of the Laplacian, grey levels; the 90th percentile, since most of a wall is smooth and a few glints
    are very sharp."""
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (3, 3), 0)
    response = np.abs(cv2.Laplacian(smooth, cv2.CV_32F))
    return float(np.percentile(response[inside], 90))
