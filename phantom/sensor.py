"""From radiance to the picture a video processor hands out: lens, gain, noise, encoding, mask."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from phantom.config import ImagingConfig

Floats = NDArray[np.float32]
LUMA = np.array([0.299, 0.587, 0.114], np.float32)
GAIN_STEPS = 6  # the clipped mean converges within a few per cent


class Sensor:
    """Holds what the processor remembers from frame to frame: the gain."""

    def __init__(self, imaging: ImagingConfig, width: int, height: int) -> None:
        self._imaging = imaging
        self._falloff = _vignette(imaging.vignette, width, height)
        self.window = border_window(imaging.border, width, height)
        self._gain: float | None = None

    def expose(self, radiance: Floats, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Linear radiance (H,W,3) to an encoded RGB image (H,W,3) uint8."""
        imaging = self._imaging
        light = radiance * self._falloff[..., None]
        if imaging.blur_px:
            light = cv2.GaussianBlur(light, (0, 0), imaging.blur_px)
        self._gain = self._adapt(light)
        encoded = np.clip(light * self._gain, 0.0, 1.0) ** (1.0 / imaging.gamma)
        if imaging.noise:
            encoded += imaging.noise * rng.standard_normal(encoded.shape, dtype=np.float32)
        encoded *= self.window[..., None]
        return np.clip(encoded * 255 + 0.5, 0, 255).astype(np.uint8)

    def _adapt(self, light: Floats) -> float:
        """Gain that brings the clipped mean brightness to the target, eased from the last frame's."""
        imaging = self._imaging
        brightness = (light[::2, ::2] @ LUMA)[self.window[::2, ::2]]
        gain = imaging.exposure / max(float(brightness.mean()), 1e-9)
        for _ in range(GAIN_STEPS):
            gain *= imaging.exposure / max(float(np.minimum(brightness * gain, 1.0).mean()), 1e-9)
        if self._gain is None or not imaging.exposure_smoothing:
            return gain
        return self._gain**imaging.exposure_smoothing * gain ** (1 - imaging.exposure_smoothing)


def smear(radiance: Floats, flow: Floats, shutter: float, taps: int = 5) -> Floats:
    """Motion blur: average (H,W,3) along the pixel flow (H,W,2) while the shutter is open."""
    height, width = radiance.shape[:2]
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    total = np.zeros_like(radiance)
    for part in np.linspace(-0.5, 0.5, taps, dtype=np.float32) * shutter:
        moved = x + part * flow[..., 0], y + part * flow[..., 1]
        total += cv2.remap(radiance, *moved, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return (total / taps).astype(np.float32)


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
    raise ValueError(f"unknown border {border!r}; known: none, circle, octagon")


def _vignette(strength: float, width: int, height: int) -> Floats:
    """Relative illumination (H,W), `1 - strength` in the corners."""
    x = (np.arange(width) + 0.5 - width / 2)[None] / (width / 2)
    y = (np.arange(height) + 0.5 - height / 2)[:, None] / (height / 2)
    return (1 - strength * (x**2 + y**2) / 2).astype(np.float32)
