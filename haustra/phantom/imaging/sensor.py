"""Sensor and video processor: radiance to an 8-bit image.

In this order: lens (vignette, blur, defocus), gain, display encoding, noise, edge enhancement, mask and text,
colour at half resolution, JPEG. A term at zero leaves the image unchanged to the bit.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import PhantomError
from haustra.phantom.config import ImagingConfig
from haustra.phantom.imaging.processor_overlay import Overlay

Floats = NDArray[np.float32]
LUMA = np.array([0.299, 0.587, 0.114], np.float32)  # ITU-R BT.601, as JPEG has it
GAIN_STEPS = 6  # fixed-point iterations of the gain; the clipped mean converges within a few per cent
REFERENCE_PX = 320  # image width that `defocus_px` refers to
MAX_DEFOCUS = 3.0  # upper bound of the blur over `defocus_px`, which a wall at the lens would exceed
DEFOCUS_STEPS = (0.5, 1.2, MAX_DEFOCUS)  # blur over `defocus_px` of the blurred copies, blended in between
BLEED = 0.02  # least weight of a pixel in a blurred copy; 1 would let sharp edges glow into the blur
HALO_PX = 1.3  # standard deviation of edge enhancement at REFERENCE_PX


class Sensor:
    """Sensor and processor with their state from frame to frame: gain and frame counter."""

    def __init__(self, imaging: ImagingConfig, width: int, height: int, seed: int = 0, fps: float = 30.0) -> None:
        """`window` (H,W) is True where the image shows the wall: inside the mask and beside the text."""
        self._imaging = imaging
        self._scale = width / REFERENCE_PX
        self._falloff = _vignette(imaging.vignette, width, height)[..., None]
        self._mask = border_window(imaging.border, width, height)
        self._overlay = Overlay(width, height, seed, fps) if imaging.text else None
        self._written = self._overlay.area() if self._overlay else np.zeros_like(self._mask)
        self.window = self._mask & ~self._written
        self._gain: float | None = None
        self._count = 0

    def expose(self, radiance: Floats, rng: np.random.Generator, depth: Floats | None = None) -> NDArray[np.uint8]:
        """Linear radiance (H,W,3) to an encoded RGB image (H,W,3) uint8.

        `depth` (H,W) is z-depth in mm, 0 where no wall is seen; without it everything is in focus.
        """
        imaging = self._imaging
        light = radiance * self._falloff
        if imaging.blur_px:
            light = cv2.GaussianBlur(light, (0, 0), imaging.blur_px)
        if imaging.defocus_px and depth is not None:
            light = defocus(light, depth, imaging.focus_mm, imaging.defocus_px * self._scale)
        self._gain = self._adapt(light)
        light *= np.float32(self._gain)
        encoded = saturated(light, imaging.crosstalk) ** (1.0 / imaging.gamma)
        if imaging.noise:
            encoded += imaging.noise * rng.standard_normal(encoded.shape, dtype=np.float32)
        return self._process(encoded)

    def _process(self, encoded: Floats) -> NDArray[np.uint8]:
        """Image (H,W,3) uint8 after the processor, from the sensor's encoded one, which is overwritten."""
        imaging = self._imaging
        if imaging.sharpen:
            encoded = enhance_edges(encoded, imaging.sharpen, HALO_PX * self._scale)
        if imaging.border != "none":
            encoded *= self._mask[..., None]
        if self._overlay:
            self._overlay.draw(encoded, self._count, self._written)
        self._count += 1
        if imaging.chroma_px > 1:
            encoded = coarse_colour(encoded, imaging.chroma_px)
        encoded *= 255
        encoded += 0.5
        image = np.clip(encoded, 0, 255, out=encoded).astype(np.uint8)
        return jpeg(image, imaging.jpeg_quality, imaging.chroma_px) if imaging.jpeg_quality else image

    def _adapt(self, light: Floats) -> float:
        """Fixed gain, or the one that brings the clipped mean brightness to the target, smoothed over frames.

        A first frame has no gain before it: `gain_error` says how far that was off, and wears off like any lag.
        """
        imaging = self._imaging
        if imaging.fixed_gain:
            return imaging.fixed_gain
        brightness = (light[::2, ::2] @ LUMA)[self.window[::2, ::2]]
        gain = imaging.exposure / max(float(brightness.mean()), 1e-9)
        for _ in range(GAIN_STEPS):
            gain *= imaging.exposure / max(float(np.minimum(brightness * gain, 1.0).mean()), 1e-9)
        if self._gain is None:
            return gain * imaging.gain_error
        if not imaging.exposure_smoothing:
            return gain
        return self._gain**imaging.exposure_smoothing * gain ** (1 - imaging.exposure_smoothing)


def saturated(light: Floats, crosstalk: float) -> Floats:
    """Light (H,W,3), overwritten, as a sensor clips it to [0,1].

    A pixel's filter lets some of the other colours pass; the processor subtracts that again, after the pixel has
    clipped. So what is far too bright turns white, where channels that clip each for itself would leave it red.
    """
    if crosstalk:
        white = (light @ LUMA)[..., None]
        # Channels through overlapping filters, c = light + crosstalk (white - light), clipped, and taken apart again:
        # the sum that clips at 1 is restored by its own white, which the clipped channels have too.
        mixed = np.minimum(light + np.float32(crosstalk) * (white - light), np.float32(1))
        rest = np.float32(1 - crosstalk)
        own_white = (mixed @ LUMA)[..., None]
        light = own_white + (mixed - own_white) / rest
    return np.clip(light, 0.0, 1.0, out=light)


def defocus_sigma(depth: Floats, focus_mm: float, defocus_px: float) -> Floats:
    """Blur (H,W) px, standard deviation, of a wall at z-depth (H,W) mm; 0 counts as infinitely far.

    A thin lens' circle of confusion is proportional to |1 - focus / depth|; it is 1 at half the focus distance
    and tends to 1 far away.
    """
    ratio = np.divide(np.float32(focus_mm), depth, out=np.zeros_like(depth), where=depth > 0)
    return np.float32(defocus_px) * np.minimum(np.abs(1 - ratio), np.float32(MAX_DEFOCUS))


def defocus(light: Floats, depth: Floats, focus_mm: float, defocus_px: float) -> Floats:
    """Blur (H,W,3) by distance (H,W) mm: neighbouring ones of a few blurred copies are mixed.

    The variance of a mixture is the mixture of variances, so the weights are linear in the squared blur.
    Pixels sharper than a copy have little weight in it, so that a near rim does not glow into the far wall.
    """
    sigma = defocus_sigma(depth, focus_mm, defocus_px)
    steps = np.array([0.0, *DEFOCUS_STEPS], np.float32) * np.float32(defocus_px)
    place = np.zeros_like(sigma)  # which copy, counted from the sharp one, fractional in between
    for below, step in zip(steps**2, steps[1:] ** 2):
        place += np.clip((sigma * sigma - below) / (step - below), 0, 1)
    packed = cv2.merge([*cv2.split(light), np.ones_like(sigma)])  # four channels: cv2's fast paths
    mixed = packed * _four(np.maximum(1 - place, 0))
    for index, step in enumerate(steps[1:], start=1):
        part = np.maximum(1 - np.abs(place - np.float32(index)), 0)
        if not part.any():
            continue
        copy = cv2.GaussianBlur(packed * _four(np.clip(sigma / step, BLEED, 1.0)), (0, 0), float(step))
        mixed += copy * _four(part / copy[..., 3])
    return cv2.merge(cv2.split(mixed)[:3])


def _four(weight: Floats) -> Floats:
    """A weight (H,W) repeated for four channels."""
    return cv2.merge([weight] * 4)


def enhance_edges(encoded: Floats, strength: float, reach_px: float) -> Floats:
    """Unsharp mask on the brightness of (H,W,3), as processors do it: edges get a bright and a dark seam."""
    luma = encoded @ LUMA
    detail = luma - cv2.GaussianBlur(luma, (0, 0), reach_px)
    return np.clip(encoded + np.float32(strength) * detail[..., None], 0.0, 1.0)


def coarse_colour(encoded: Floats, block_px: int) -> Floats:
    """Chroma subsampling of (H,W,3): mean colour per block of pixels; brightness keeps its resolution."""
    height, width = encoded.shape[:2]
    luma = (encoded @ LUMA)[..., None]
    colour = cv2.copyMakeBorder(encoded - luma, 0, -height % block_px, 0, -width % block_px, cv2.BORDER_REPLICATE)
    size = colour.shape[1], colour.shape[0]
    small = cv2.resize(colour, (size[0] // block_px, size[1] // block_px), interpolation=cv2.INTER_AREA)
    return luma + cv2.resize(small, size, interpolation=cv2.INTER_NEAREST)[:height, :width]


def jpeg(image: NDArray[np.uint8], quality: int, chroma_px: int) -> NDArray[np.uint8]:
    """An RGB image (H,W,3) after a recorder's JPEG; colour at half resolution (4:2:0) if `chroma_px` is 2."""
    factor = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420 if chroma_px == 2 else cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, factor]
    _, data = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), options)
    return cv2.cvtColor(cv2.imdecode(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)


def smear(radiance: Floats, flow: Floats, shutter: float, taps: int = 5) -> Floats:
    """Motion blur: average (H,W,3) along the pixel flow (H,W,2) while the shutter is open."""
    height, width = radiance.shape[:2]
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    along, down = cv2.split(flow)
    packed = cv2.merge([*cv2.split(radiance), x])  # cv2.remap is twice as fast on four channels as on three
    total = np.zeros_like(packed)
    # The middles of equal parts of the exposure: its very ends would make the blur a fifth too long.
    for part in ((np.arange(taps, dtype=np.float32) + np.float32(0.5)) / taps - np.float32(0.5)) * np.float32(shutter):
        moved = x + part * along, y + part * down
        total += cv2.remap(packed, *moved, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    total /= taps
    return cv2.merge(cv2.split(total)[:3])


def border_window(border: str, width: int, height: int) -> NDArray[np.bool_]:
    """True where the processor shows the image (H,W)."""
    x = np.abs(np.arange(width) + 0.5 - width / 2)[None] / (width / 2)
    y = np.abs(np.arange(height) + 0.5 - height / 2)[:, None] / (height / 2)
    if border == "circle":
        return x**2 + y**2 < 1.0
    if border == "octagon":
        return x + y < 1.45
    if border == "none":
        return np.ones((height, width), bool)
    raise PhantomError(f"unknown border {border!r}; known: none, circle, octagon")


def _vignette(strength: float, width: int, height: int) -> Floats:
    """Relative illumination (H,W), `1 - strength` in the corners."""
    x = (np.arange(width) + 0.5 - width / 2)[None] / (width / 2)
    y = (np.arange(height) + 0.5 - height / 2)[:, None] / (height / 2)
    return (1 - strength * (x**2 + y**2) / 2).astype(np.float32)
