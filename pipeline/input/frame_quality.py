"""Is a frame worth tracking? Black, overexposed, red-out, plain, blurred and repeated frames are named and left out."""

from collections import deque
from dataclasses import dataclass, field
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

Verdict = Literal[
    "used", "black", "overexposed", "red-out", "no texture", "blurred", "duplicate", "other layout", "other zoom"
]
HISTORY = 15  # frames over which sharpness is compared
MIN_BRIGHTNESS = 8.0  # grey levels; a darker median frame is black
SATURATED, MAX_SATURATED = 250, 0.6  # grey level, and share of pixels at it beyond which nothing is left to see
# Texture is looked for at a scale that a codec and white noise of up to some eight levels leave alone: a share of the
# long side, and at most so many pixels. Red-out has 0.6 grey levels there, the smoothest wall 1.7 (events_b and
# low_texture_b, on which this was chosen).
TEXTURE_SCALE, MOST_TEXTURE_SCALE_PX = 0.01, 3.2
MIN_TEXTURE = 1.2  # grey levels
# A lens that lies on the wall sees light that has gone through tissue: redder than the film is else, with little
# texture, but drops and slime on the lens have more than the least. Chosen on events_b: of its frames those of
# which nothing of the wall is left are redder by 0.24 and more, all others by 0.14 at most.
REDDER = 0.2  # log2 of red over green, above the usual
LESS_TEXTURE = 0.5  # of the usual
# Latest frames whose medians are the usual, and how many it takes. Red-out is among them: where a film turns red for
# good, as one that begins outside the patient, that is the usual after as many frames again.
USUAL, LEAST_USUAL = 300, 60
DIM, COLOUR_STEP = 30, 4  # grey level below which colour is noise, and pixels between those that are looked at
GLINT = 240  # grey level of the brightest channel; a glint is structure of its own
LEAST_LEFT = 0.1  # share of the content that must be left without glints and border for them to be left out
MIN_RELATIVE_SHARPNESS = 0.3  # of the running median; a third is motion blur
MIN_CHANGE = 0.35  # grey levels between thumbnails; compression alone gives 0.2


@dataclass
class FrameJudge:
    """Judges frames in order; remembers recent sharpness and the last frame that was used."""

    _sharpness: deque[float] = field(default_factory=lambda: deque(maxlen=HISTORY))
    _last: NDArray[np.float32] | None = None
    _usual: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=USUAL))  # redness, texture

    def judge(self, rgb: NDArray[np.uint8], content: NDArray[np.uint8]) -> Verdict:
        """rgb (H,W,3) and content mask (H,W), both at working size."""
        inside = content > 0
        channels = np.maximum.reduce(cv2.split(rgb))
        brightest = channels[inside]
        if np.median(brightest) < MIN_BRIGHTNESS:
            return "black"
        if (brightest >= SATURATED).mean() > MAX_SATURATED:
            return "overexposed"
        grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
        small = thumbnail(grey)
        if self._last is not None and np.abs(small - self._last).mean() < MIN_CHANGE:
            return "duplicate"
        redness, texture = _redness(rgb, channels, inside), _texture(grey, inside, channels >= GLINT)
        red_out = self._is_red_out(redness, texture)
        self._usual.append((redness, texture))
        if red_out:
            return "red-out"
        if texture < MIN_TEXTURE:
            return "no texture"
        sharpness = _sharpness(grey, inside)
        # A running median that only grows from sharp frames would never accept a softer passage: all count.
        self._sharpness.append(sharpness)
        if sharpness < MIN_RELATIVE_SHARPNESS * float(np.median(self._sharpness)):
            return "blurred"
        self._last = small
        return "used"

    def _is_red_out(self, redness: float, texture: float) -> bool:
        if len(self._usual) < LEAST_USUAL:
            return False
        usual_redness, usual_texture = np.median(self._usual, axis=0)
        return bool(redness > usual_redness + REDDER and texture < LESS_TEXTURE * usual_texture)


def thumbnail(grey: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(64,64) of a grey picture (H,W), by which frames are compared."""
    return cv2.resize(grey, (64, 64), interpolation=cv2.INTER_AREA).astype(np.float32)


def _redness(rgb: NDArray[np.uint8], channels: NDArray[np.uint8], inside: NDArray[np.bool_]) -> float:
    """Median of log2 red over green where neither glints nor the dark have a colour of their own; 0 where all do."""
    some = (slice(None, None, COLOUR_STEP),) * 2
    coloured = inside[some] & (channels[some] >= DIM) & (channels[some] < GLINT)
    if not coloured.any():
        return 0.0
    red, green, _ = 1.0 + rgb[some][coloured].T
    return float(np.median(np.log2(red / green)))


def _texture(grey: NDArray[np.uint8], inside: NDArray[np.bool_], glints: NDArray[np.bool_]) -> float:
    """Spread of the scale-normalised Laplacian of a Gaussian, grey levels, away from glints and from the border."""
    scale = min(MOST_TEXTURE_SCALE_PX, TEXTURE_SCALE * max(grey.shape))
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), scale)
    response = scale**2 * np.abs(cv2.Laplacian(smooth, cv2.CV_32F))
    around = 2 * round(3 * scale) + 1
    away = cv2.erode((inside & ~glints).astype(np.uint8), np.ones((around, around), np.uint8)) > 0
    enough = away.sum() > LEAST_LEFT * inside.sum()
    return float(np.percentile(response[away if enough else inside], 90))


def _sharpness(grey: NDArray[np.uint8], inside: NDArray[np.bool_]) -> float:
    """Spread of the Laplacian, grey levels; the 90th percentile, since most of a wall is smooth and a few glints
    are very sharp."""
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (3, 3), 0)
    response = np.abs(cv2.Laplacian(smooth, cv2.CV_32F))
    return float(np.percentile(response[inside], 90))
