"""Refuse, in one sentence, a config that cannot be built or filmed, before any time is spent on it."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

from phantom.config import PhantomConfig
from phantom.errors import PhantomError

RANGES = {  # section.field: least and most
    "anatomy.length_mm": (40.0, 2000.0),
    "anatomy.radius_mm": (3.0, 60.0),
    "anatomy.edge_mm": (0.2, 5.0),
    "anatomy.bend": (0.0, 0.95),
    "anatomy.collapse": (0.0, 0.9),
    "anatomy.fold_spacing_mm": (2.0, math.inf),
    "anatomy.fold_edge_mm": (0.05, math.inf),
    "anatomy.fold_width_mm": (0.1, math.inf),
    "appearance.texel_mm": (0.05, 2.0),
    "appearance.stool": (0.0, 0.9),
    "appearance.fluid": (0.0, 0.9),
    "imaging.lights": (1, 16),
    "imaging.exposure": (1e-3, 0.95),
    "imaging.exposure_smoothing": (0.0, 0.999),
    "imaging.gamma": (0.2, 5.0),
    "imaging.shutter": (0.0, 1.0),
    "imaging.chroma_px": (1, 2),
    "imaging.jpeg_quality": (0, 100),
    "camera.width": (16, 4096),
    "camera.height": (16, 4096),
    "camera.fov_deg": (5.0, 179.0),
    "motion.frames": (1, 100_000),
    "motion.fps": (1.0, 1000.0),
    "motion.start": (0.0, 1.0),
    "motion.speed_mm": (0.0, 20.0),
    "motion.wobble_period": (2.0, math.inf),
    "motion.touch_mm": (0.3, 10.0),
    "motion.manoeuvre_s": (0.05, 60.0),
    "events.duration_s": (0.05, 60.0),
    "events.contraction": (0.0, 0.8),
}


def check(config: PhantomConfig) -> None:
    """Raise PhantomError for the first value out of range, not finite, or negative where that means nothing."""
    for section in ("anatomy", "appearance", "imaging", "camera", "motion", "events"):
        part = getattr(config, section)
        for field in fields(part):
            _check_one(f"{section}.{field.name}", getattr(part, field.name))
    camera = config.camera
    if camera.width % 2 or camera.height % 2:
        raise PhantomError(f"camera: H.264 needs an even width and height, got {camera.width}x{camera.height}")


def _check_one(name: str, value: Any) -> None:
    numbers = value if isinstance(value, tuple) else (value,)
    for number in numbers:
        if isinstance(number, float) and not math.isfinite(number):
            raise PhantomError(f"{name}: expected a finite number, got {number}")
    if type(value) is int and value < 0:
        raise PhantomError(f"{name}: expected a count, got {value}")
    if name in RANGES:
        least, most = RANGES[name]
        if not least <= value <= most:
            raise PhantomError(f"{name}: {value:g} is not within {least:g} to {most:g}")
