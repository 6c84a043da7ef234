"""Photometric model of an endoscope: illumination by distance, slant and angle off the axis, fitted and divided out.

The light source sits at the camera, so a Lambertian wall of one albedo has luminance cos(theta) / r^2: r along the
ray, theta between ray and normal. A recorded image has passed a tone curve and automatic exposure, the light guide is
wide and brightest ahead, the lens darkens the corners, and other walls reflect light back, so the exponents are fitted
to the video itself, with an exposure gain for each frame:

    log luminance = exposure_gain + a log r + b log cos(theta) + c log cos(phi),  phi between ray and optical axis;

a = -2, b = 1, c = 0 for a point source. Without the third term, vignetting of a camera that backs away would be
explained by distance. Where the lamp was measured (`Lamp`), its own fall-off takes the third term's place.

Two assumptions on the mucosa: its albedo does not depend on distance, and each frame sees the same median albedo, since
each frame's median is brought to the video's: automatic exposure cannot be told from a stretch of pale or of inflamed
wall. Colours may be compared within a view, not between far stretches of a video.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from reconstruction.fusion.depth_frame import view_cosine
from reconstruction.fusion.lamp import Lamp

GAMMA = 2.2  # of the display encoding
LUMA = np.array([0.2126, 0.7152, 0.0722], np.float32)  # ITU-R BT.709, linear
MIN_GREY, MAX_GREY = 12, 248  # grey levels (8 bit) of a pixel that is neither under- nor overexposed
MIN_COSINE = 0.15  # cosine of the slant below which a normal of completed depth is mostly error
MIN_PIXELS = 200  # usable pixels of a frame below which it takes no part in the fit
SAMPLES = 2000  # pixels drawn from each frame for the fit
SMOOTH_SHARE = 0.02  # sigma over image width of the blur before normals are taken (docs/lab/retired_experiments.md)
EXPONENT_BOUNDS = ((-3.0, 0.0), (0.0, 2.0), (-1.0, 6.0))  # of distance, slant, axis; light does not grow with distance
MAX_LOG_CORRECTION = np.log(6.0)  # log factor on a pixel's luminance beyond which only its noise would show
NOISE = 0.15  # sigma of log luminance by the mucosa's albedo pattern: scale of the soft L1 loss


@dataclass(frozen=True)
class Illumination:
    """Fitted illumination model: exponents of distance along the ray, cosine of the slant, cosine off the axis."""

    distance: float
    slant: float
    axis: float
    level: float  # mean over frames of the shading-corrected median log luminance, at distance `reference`
    reference: float  # median distance, unit of the depth
    frames: int  # frames that took part in the fit
    lamp: Lamp | None = None  # measured; then `axis` is 1, the exponent of its emission

    @property
    def gamma(self) -> float:
        return GAMMA if self.lamp is None else self.lamp.gamma

    def shading_corrected(
        self, rgb: NDArray[np.uint8], depth: NDArray[np.float32], intrinsics: NDArray[np.float64]
    ) -> NDArray[np.uint8]:
        """Image (H,W,3) uint8 sRGB with illumination and exposure gain divided out; pixels without depth unchanged.

        rgb (H,W,3) uint8; depth (H,W) z-depth, 0 = none; intrinsics (3,3), the top-left pixel's centre at (0.5, 0.5).
        """
        shade, known = self._log_shade(depth, intrinsics)
        if known.sum() < MIN_PIXELS:
            return rgb
        linear = _linear(rgb, self.gamma)
        exposure_gain = _median_exposure_gain(linear, shade, known & _is_exposed(rgb))
        brighten = 0.0 if exposure_gain is None else self.level - exposure_gain
        factor = np.exp(np.clip(brighten - shade, -MAX_LOG_CORRECTION, MAX_LOG_CORRECTION))
        result = np.where(known[..., None], linear * factor[..., None], linear)
        return np.rint(255 * np.clip(result, 0, 1) ** (1 / self.gamma)).astype(np.uint8)

    def _log_shade(
        self, depth: NDArray[np.float32], intrinsics: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Model log shading (H,W), and where depth is known (H,W)."""
        distance, cosine, ahead = geometry(depth, intrinsics)
        known = distance > 0
        ratio = np.where(known, distance / self.reference, 1)
        shade = self.distance * np.log(ratio) + self.slant * np.log(np.maximum(cosine, MIN_COSINE))
        return (shade + self.axis * np.log(_off_axis(ahead, intrinsics, self.lamp))).astype(np.float32), known


def geometry(
    depth: NDArray[np.float32], intrinsics: NDArray[np.float64], smooth_share: float = SMOOTH_SHARE
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Distance along the ray, cosine of the slant (both 0 without depth), cosine off the optical axis; (H,W) each.

    depth (H,W) z-depth; the slant is that of log depth blurred by a Gaussian of sigma `smooth_share` of the width,
    since normals of completed depth are too rough to divide by.
    """
    clean = np.where(np.isfinite(depth) & (depth > 0), depth, 0).astype(np.float32)
    centred = np.array(intrinsics, np.float64)
    centred[:2, 2] -= 0.5
    height, width = depth.shape
    x = (np.arange(width) - centred[0, 2]) / centred[0, 0]
    y = (np.arange(height) - centred[1, 2]) / centred[1, 1]
    ray = np.sqrt(x[None, :] ** 2 + y[:, None] ** 2 + 1).astype(np.float32)
    return clean * ray, view_cosine(_blurred(clean, smooth_share * width), centred), 1 / ray


def _blurred(depth: NDArray[np.float32], sigma_px: float) -> NDArray[np.float32]:
    """Depth (H,W) blurred in its logarithm over known pixels, normalised convolution; 0 stays 0."""
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


def _off_axis(ahead: NDArray[np.float32], intrinsics: NDArray[np.float64], lamp: Lamp | None) -> NDArray[np.float32]:
    """(H,W) what the third exponent is of: the cosine off the axis, or a measured lamp's emission."""
    if lamp is None:
        return ahead
    height, width = ahead.shape
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    plane = (x - intrinsics[0, 2]) / intrinsics[0, 0], (y - intrinsics[1, 2]) / intrinsics[1, 1]
    rays = np.stack([*plane, np.ones_like(x)], axis=-1).astype(np.float32) * ahead[..., None]
    return np.exp(lamp.log_emission(rays))


def fit_illumination(
    frames: Iterable[tuple[NDArray[np.uint8], NDArray[np.float32]]],
    intrinsics: NDArray[np.float64],
    seed: int = 0,
    lamp: Lamp | None = None,
) -> Illumination | None:
    """Robust fit of the exponents to pairs of image and depth (shapes as in `Illumination.shading_corrected`).

    None if no frame has MIN_PIXELS usable pixels. `seed` fixes which pixels are drawn. lamp: measured; distance and
    slant alone are fitted then.
    """
    rng = np.random.default_rng(seed)
    found = [_samples(rgb, depth, intrinsics, rng, lamp) for rgb, depth in frames]
    used = [sample for sample in found if sample is not None]
    if not used:
        return None
    solved = _exponents(used, lamp)
    distance = np.concatenate([sample[:, 1] for sample in used])
    reference = float(np.median(distance))
    shades = [sample[:, 0] - (sample[:, 1:] - (reference, 0, 0)) @ solved for sample in used]
    level = float(np.mean([np.median(shade) for shade in shades]))
    by_distance, by_slant, by_axis = map(float, solved)
    return Illumination(by_distance, by_slant, by_axis, level, float(np.exp(reference)), len(used), lamp)


def _exponents(samples: list[NDArray[np.float64]], lamp: Lamp | None) -> NDArray[np.float64]:
    """(3,) of distance, slant and axis, of each frame's samples (N,4); the third is 1 where the lamp was measured."""
    if lamp is not None:
        samples = [np.column_stack([sample[:, 0] - sample[:, 3], sample[:, 1:3]]) for sample in samples]
    # Centred frame by frame, so that each frame's exposure gain drops out.
    centred = np.concatenate([sample - np.median(sample, axis=0) for sample in samples])
    free = centred.shape[1] - 1

    def residual(exponents: NDArray[np.float64]) -> NDArray[np.float64]:
        return centred[:, 0] - centred[:, 1:] @ exponents

    bounds = tuple(zip(*EXPONENT_BOUNDS[:free], strict=True))
    solved = least_squares(residual, (-1.5, 0.5, 0.5)[:free], bounds=bounds, loss="soft_l1", f_scale=NOISE).x
    return np.append(solved, np.ones(3 - free))


def _samples(
    rgb: NDArray[np.uint8],
    depth: NDArray[np.float32],
    intrinsics: NDArray[np.float64],
    rng: np.random.Generator,
    lamp: Lamp | None,
) -> NDArray[np.float64] | None:
    """(N,4) logarithms of luminance, distance, slant's cosine, fall off the axis of drawn usable pixels; None if too
    few."""
    distance, cosine, ahead = geometry(depth, intrinsics)
    usable = np.flatnonzero((distance > 0) & (cosine > MIN_COSINE) & _is_exposed(rgb))
    if len(usable) < MIN_PIXELS:
        return None
    chosen = rng.choice(usable, min(SAMPLES, len(usable)), replace=False)
    bright = _linear(rgb.reshape(-1, 3)[chosen], GAMMA if lamp is None else lamp.gamma) @ LUMA
    off_axis = _off_axis(ahead, intrinsics, lamp)
    columns = (bright, *(image.ravel()[chosen] for image in (distance, cosine, off_axis)))
    return np.log(np.stack(columns, axis=1).astype(np.float64))


def _median_exposure_gain(
    linear: NDArray[np.float32], shade: NDArray[np.float32], usable: NDArray[np.bool_]
) -> float | None:
    """Median over `usable` (H,W) of log luminance less log shading; None with fewer than MIN_PIXELS."""
    if usable.sum() < MIN_PIXELS:
        return None
    return float(np.median((np.log(np.maximum(linear @ LUMA, 1e-4)) - shade)[usable]))


def _is_exposed(rgb: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """(H,W) pixels whose brightest channel is neither black nor saturated: glints would say that the wall is near."""
    brightest = np.maximum.reduce(cv2.split(rgb))
    return (brightest < MAX_GREY) & (brightest > MIN_GREY)


def _linear(rgb: NDArray[np.uint8], gamma: float) -> NDArray[np.float32]:
    """Linear light in [0,1] of grey levels, any shape."""
    return _table(gamma)[rgb]


@lru_cache(maxsize=4)
def _table(gamma: float) -> NDArray[np.float32]:
    """(256,) linear light of each grey level."""
    return np.power(np.arange(256, dtype=np.float32) / np.float32(255), np.float32(gamma))
