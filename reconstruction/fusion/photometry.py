"""The lamp divided out of the picture: what is left is the colour of the mucosa, not how near the endoscope came.

The lamp sits at the camera, so a wall of one colour shines as cos(theta) / r^2: r along the ray, theta between ray and
normal. A real picture has passed a tone curve and an automatic gain, its lamp is wide and brightest ahead, its lens
darkens the corners, and other walls throw light back, so the exponents are fitted to the film itself, with a gain of
its own for each frame:

    log luminance = gain_frame + a log r + b log cos(theta) + c log cos(phi),     phi between ray and optical axis;

a = -2, b = 1, c = 0 for a bare point lamp. Without the third term a camera that backs away takes the corners' darkness
for nearness.

Two things are assumed of the mucosa: that it is not paler where it is near, and that each frame sees on the whole the
same colour, since each frame's median is brought to the film's: the camera's automatic gain cannot be told from a
stretch of pale or of inflamed wall. Colours may be compared within a view, not between far stretches of a video.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from reconstruction.fusion.depth_frame import view_cosine

GAMMA = 2.2  # of the display encoding
LUMA = np.array([0.2126, 0.7152, 0.0722], np.float32)  # ITU-R BT.709, linear
DARK, BURNT = 12, 248  # grey levels between which a pixel says how bright its wall is
MIN_COSINE = 0.15  # flatter slopes of completed depth are mostly its error
MIN_PIXELS = 200  # of a frame that takes part in the fit
SAMPLES = 2000  # pixels of each frame
SMOOTH_SHARE = 0.02  # of the width: normals of completed depth are too rough to divide by (docs/lab)
RANGES = ((-3.0, 0.0), (0.0, 2.0), (-1.0, 6.0))  # of the exponents; light does not grow with distance
MOST = np.log(6.0)  # a pixel is brightened or darkened by no more: beyond, only its noise would show
_LINEAR = np.power(np.arange(256, dtype=np.float32) / np.float32(255), np.float32(GAMMA))  # of each grey level
NOISE = 0.15  # of log luminance by the mucosa's own pattern; residuals beyond count less (soft L1)


@dataclass(frozen=True)
class Lamp:
    """Exponents of distance, slant and angle off the axis; level: mean log luminance of the film with them divided
    out, at distance `reference` (the unit of the depth). frames: how many the fit rests on."""

    distance: float
    slant: float
    axis: float
    level: float
    reference: float
    frames: int

    def delit(
        self, rgb: NDArray[np.uint8], depth: NDArray[np.float32], intrinsics: NDArray[np.float64]
    ) -> NDArray[np.uint8]:
        """The picture (H,W,3) as one lamp at one distance, met head-on, would show it; without depth unchanged.

        depth (H,W) z-depth, 0 = none; intrinsics (3,3), the top-left pixel's centre at (0.5, 0.5). The frame's own
        gain is what brings its median to the film's.
        """
        shade, known = self._log_shade(depth, intrinsics)
        if known.sum() < MIN_PIXELS:
            return rgb
        linear = _linear(rgb)
        gain = _median_gain(linear, shade, known & _is_exposed(rgb))
        brighten = 0.0 if gain is None else self.level - gain
        factor = np.exp(np.clip(brighten - shade, -MOST, MOST))
        result = np.where(known[..., None], linear * factor[..., None], linear)
        return np.rint(255 * np.clip(result, 0, 1) ** (1 / GAMMA)).astype(np.uint8)

    def gain(self, rgb: NDArray[np.uint8], depth: NDArray[np.float32], intrinsics: NDArray[np.float64]) -> float | None:
        """The frame's median log luminance with the lamp divided out; None if too few pixels tell."""
        shade, known = self._log_shade(depth, intrinsics)
        return _median_gain(_linear(rgb), shade, known & _is_exposed(rgb))

    def _log_shade(
        self, depth: NDArray[np.float32], intrinsics: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        distance, cosine, ahead = geometry(depth, intrinsics)
        known = distance > 0
        ratio = np.where(known, distance / self.reference, 1)
        shade = self.distance * np.log(ratio) + self.slant * np.log(np.maximum(cosine, MIN_COSINE))
        return (shade + self.axis * np.log(ahead)).astype(np.float32), known


def geometry(
    depth: NDArray[np.float32], intrinsics: NDArray[np.float64], smooth_share: float = SMOOTH_SHARE
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Distance along the ray and cosine of the slant, 0 where there is no depth, and cosine of the angle off the
    optical axis; (H,W) each. The slant is that of depth blurred by a Gaussian of `smooth_share` of the width."""
    clean = np.where(np.isfinite(depth) & (depth > 0), depth, 0).astype(np.float32)
    centred = np.array(intrinsics, np.float64)
    centred[:2, 2] -= 0.5
    height, width = depth.shape
    x = (np.arange(width) - centred[0, 2]) / centred[0, 0]
    y = (np.arange(height) - centred[1, 2]) / centred[1, 1]
    ray = np.sqrt(x[None, :] ** 2 + y[:, None] ** 2 + 1).astype(np.float32)
    return clean * ray, view_cosine(_blurred(clean, smooth_share * width), centred), 1 / ray


def _blurred(depth: NDArray[np.float32], sigma_px: float) -> NDArray[np.float32]:
    """Logarithm of depth averaged over the known pixels around; 0 stays 0."""
    if sigma_px == 0:
        return depth
    known = (depth > 0).astype(np.float32)
    log = np.log(np.where(known > 0, depth, 1))
    middle = np.float32(log.sum() / max(known.sum(), 1))  # near zero, where single precision is fine whatever the unit
    log -= middle
    size = 2 * int(4 * sigma_px + 0.5) + 1  # OpenCV's own choice ends at three sigmas
    around, weight = (
        cv2.GaussianBlur(image, (size, size), sigma_px, borderType=cv2.BORDER_REFLECT) for image in (log * known, known)
    )
    mean = around / np.maximum(weight, 1e-6)
    return np.where(known > 0, np.exp(mean + middle), 0).astype(np.float32)


def fit_lamp(
    frames: Iterable[tuple[NDArray[np.uint8], NDArray[np.float32]]], intrinsics: NDArray[np.float64], seed: int = 0
) -> Lamp | None:
    """Exponents from pairs of picture and depth, shapes as in `Lamp.delit`; None if no frame has enough pixels."""
    rng = np.random.default_rng(seed)
    found = [_samples(rgb, depth, intrinsics, rng) for rgb, depth in frames]
    used = [sample for sample in found if sample is not None]
    if not used:
        return None
    # Centred frame by frame, so that each frame's gain drops out.
    centred = np.concatenate([sample - np.median(sample, axis=0) for sample in used])

    def residual(exponents: NDArray[np.float64]) -> NDArray[np.float64]:
        return centred[:, 0] - centred[:, 1:] @ exponents

    bounds = tuple(zip(*RANGES, strict=True))
    solved = least_squares(residual, (-1.5, 0.5, 0.5), bounds=bounds, loss="soft_l1", f_scale=NOISE).x
    distance = np.concatenate([sample[:, 1] for sample in used])
    reference = float(np.median(distance))
    shades = [sample[:, 0] - (sample[:, 1:] - (reference, 0, 0)) @ solved for sample in used]
    level = float(np.mean([np.median(shade) for shade in shades]))
    by_distance, by_slant, by_axis = map(float, solved)
    return Lamp(by_distance, by_slant, by_axis, level, float(np.exp(reference)), len(used))


def _samples(
    rgb: NDArray[np.uint8], depth: NDArray[np.float32], intrinsics: NDArray[np.float64], rng: np.random.Generator
) -> NDArray[np.float64] | None:
    """(N,4) log luminance, and the logarithms that it depends on, of pixels that tell of the light."""
    distance, cosine, ahead = geometry(depth, intrinsics)
    usable = np.flatnonzero((distance > 0) & (cosine > MIN_COSINE) & _is_exposed(rgb))
    if len(usable) < MIN_PIXELS:
        return None
    chosen = rng.choice(usable, min(SAMPLES, len(usable)), replace=False)
    bright = _linear(rgb.reshape(-1, 3)[chosen]) @ LUMA
    columns = (bright, *(image.ravel()[chosen] for image in (distance, cosine, ahead)))
    return np.log(np.stack(columns, axis=1).astype(np.float64))


def _median_gain(linear: NDArray[np.float32], shade: NDArray[np.float32], judged: NDArray[np.bool_]) -> float | None:
    if judged.sum() < MIN_PIXELS:
        return None
    return float(np.median((np.log(np.maximum(linear @ LUMA, 1e-4)) - shade)[judged]))


def _is_exposed(rgb: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Neither black nor burnt out in any channel: glints would say that the wall is near."""
    brightest = np.maximum.reduce(cv2.split(rgb))
    return (brightest < BURNT) & (brightest > DARK)


def _linear(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    return _LINEAR[rgb]
