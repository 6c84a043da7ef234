"""Validation of a config: a PhantomError of one sentence before any time is spent on what cannot be built."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

from haustra.core.errors import PhantomError
from haustra.phantom.config import PhantomConfig
from haustra.phantom.imaging.camera import MODELS, make_camera
from haustra.phantom.imaging.readout import EXPOSURES
from haustra.phantom.imaging.sensor import border_window
from haustra.phantom.motion.camera_path import DIRECTIONS
from haustra.phantom.timeline import plan_timeline

CHOICES = {
    "anatomy.scene": ("colon", "small_intestine"),
    "imaging.border": ("none", "circle", "octagon"),
    "imaging.readout": tuple(EXPOSURES),
    "camera.model": MODELS,
    "motion.direction": tuple(DIRECTIONS),
}
FREE_TEXT = ("motion.recording",)
MANY = math.inf
SHARE, ANY, POSITIVE = (0.0, 1.0), (-MANY, MANY), (0.0, MANY)
RANGES = {  # section.field: least and most; of a tuple, of each of its numbers
    "anatomy.length_mm": (40.0, 2000.0),
    "anatomy.radius_mm": (3.0, 60.0),
    "anatomy.radius_variation": (0.0, 0.8),
    "anatomy.bend": (0.0, 0.95),
    "anatomy.flexures": (0, 50),
    "anatomy.pinch_mm": (1.0, MANY),
    "anatomy.taenia_depth_mm": POSITIVE,
    "anatomy.taenia_twist_deg_per_mm": (-10.0, 10.0),
    "anatomy.sacculation_mm": (0.0, 20.0),
    "anatomy.fold_spacing_mm": (2.0, MANY),
    "anatomy.fold_spacing_jitter": (0.0, 0.9),
    "anatomy.fold_depth_mm": POSITIVE,
    "anatomy.fold_depth_jitter": (0.0, 2.0),
    "anatomy.fold_width_mm": (0.1, MANY),
    "anatomy.fold_edge_mm": (0.05, MANY),
    "anatomy.fold_tilt_mm": POSITIVE,
    "anatomy.fold_lean": (0.0, 2.0),
    "anatomy.relief_mm": (0.0, 5.0),
    "anatomy.polyps": (0, 1000),
    "anatomy.polyp_radius_mm": (0.3, 20.0),
    "anatomy.pedunculated": (0, 100),
    "anatomy.flat": (0, 100),
    "anatomy.diverticula": (0, 200),
    "anatomy.diverticulum_mm": (0.5, 10.0),
    "anatomy.villi_mm": (0.0, 2.0),
    "anatomy.collapse": (0.0, 0.9),
    "anatomy.edge_mm": (0.2, 5.0),
    "appearance.tissue": SHARE,
    "appearance.tissue_other": SHARE,
    "appearance.blotch_mm": (1.0, MANY),
    "appearance.contrast": (1.0, 20.0),
    "appearance.mottle": (0.0, 1.0),
    "appearance.grain": (0.0, 1.0),
    "appearance.erythema": (0.0, 1.0),
    "appearance.vessel_colour": SHARE,
    "appearance.mesh_vessels": SHARE,
    "appearance.mesh_cell_mm": (1.0, MANY),
    "appearance.mesh_width_mm": (0.02, 10.0),
    "appearance.tree_vessels": SHARE,
    "appearance.trees_per_cm2": (0.0, 5.0),
    "appearance.tree_width_mm": (0.02, 10.0),
    "appearance.bump_mm": (0.0, 1.0),
    "appearance.cavity": SHARE,
    "appearance.stool": (0.0, 0.9),
    "appearance.stool_colour": SHARE,
    "appearance.fluid": (0.0, 0.9),
    "appearance.fluid_colour": SHARE,
    "appearance.texel_mm": (0.05, 2.0),
    "imaging.lights": (1, 16),
    "imaging.light_offset_mm": (0.0, 20.0),
    "imaging.light_shift_mm": (-20.0, 20.0),
    "imaging.light_roll_deg": ANY,
    "imaging.light_lobe": (0.0, 20.0),
    "imaging.lobe_tilt_deg": (0.0, 60.0),
    "imaging.lobe_roll_deg": ANY,
    "imaging.light_colour": (0.0, 10.0),
    "imaging.ambient": (0.0, 10.0),
    "imaging.bounce": (0.0, 5.0),
    "imaging.wrap": SHARE,
    "imaging.specular": (0.0, 10.0),
    "imaging.shininess": (1.0, 1e5),
    "imaging.exposure": (1e-3, 0.95),
    "imaging.exposure_smoothing": (0.0, 0.999),
    "imaging.fixed_gain": (0.0, 1e6),
    "imaging.gain_error": (1e-3, 1e3),
    "imaging.crosstalk": (0.0, 0.95),
    "imaging.gamma": (0.2, 5.0),
    "imaging.vignette": SHARE,
    "imaging.noise": (0.0, 1.0),
    "imaging.blur_px": (0.0, 50.0),
    "imaging.shutter": SHARE,
    "imaging.focus_mm": (0.5, MANY),
    "imaging.defocus_px": (0.0, 50.0),
    "imaging.sharpen": (0.0, 10.0),
    "imaging.chroma_px": (1, 2),
    "imaging.jpeg_quality": (0, 100),
    "camera.width": (16, 4096),
    "camera.height": (16, 4096),
    "camera.fov_deg": (5.0, 179.0),
    "camera.distortion": (-10.0, 10.0),
    "camera.focal_px": (0.0, 1e5),
    "camera.centre_px": (0.0, 1e5),
    "motion.frames": (1, 100_000),
    "motion.fps": (1.0, 1000.0),
    "motion.start": SHARE,
    "motion.speed_mm": (0.0, 20.0),
    "motion.speed_variation": SHARE,
    "motion.wobble_mm": (0.0, 30.0),
    "motion.wobble_period": (2.0, MANY),
    "motion.look_deg": (0.0, 180.0),
    "motion.roll_deg": (0.0, 180.0),
    "motion.ahead_mm": (1.0, MANY),
    "motion.clearance_mm": (0.3, 30.0),
    "motion.pauses": (0, 1000),
    "motion.touches": (0, 1000),
    "motion.touch_mm": (0.3, 10.0),
    "motion.quick_turns": (0, 1000),
    "motion.quick_turn_deg": (0.0, 180.0),
    "motion.look_backs": (0, 1000),
    "motion.look_back_deg": (0.0, 180.0),
    "motion.manoeuvre_s": (0.05, 60.0),
    "events.red_outs": (0, 1000),
    "events.water_jets": (0, 1000),
    "events.bubbles": (0, 1000),
    "events.tools": (0, 1000),
    "events.peristalsis": (0, 1000),
    "events.duration_s": (0.05, 60.0),
    "events.contraction": (0.0, 0.8),
    "tissue.amplitude_mm": (0.0, 20.0),
    "tissue.wave_speed_mm_s": (0.1, 200.0),
    "tissue.breath_s": (0.2, 600.0),
    "tissue.insufflation_s": (0.2, 600.0),
}
MIN_TEXT_PX = 128  # image width below which burned-in text covers most of it


def check(config: PhantomConfig) -> None:
    """Raise PhantomError for the first value that is unknown, not finite or out of range, a lens that folds
    over, or a film too short for what is to happen in it."""
    for section in ("anatomy", "appearance", "imaging", "camera", "motion", "events", "tissue"):
        part = getattr(config, section)
        for field in fields(part):
            _check_one(f"{section}.{field.name}", getattr(part, field.name))
    camera = config.camera
    if camera.width % 2 or camera.height % 2:
        raise PhantomError(f"camera: H.264 needs an even width and height, got {camera.width}x{camera.height}")
    if config.imaging.text and camera.width < MIN_TEXT_PX:
        raise PhantomError(f"imaging.text needs a picture at least {MIN_TEXT_PX} px wide, got {camera.width}")
    if camera.model == "PINHOLE" and any(camera.distortion):
        raise PhantomError("camera: PINHOLE has no distortion; take OPENCV or OPENCV_FISHEYE")
    if config.tissue.amplitude_mm and config.events.peristalsis:
        raise PhantomError("tissue.amplitude_mm moves the wall all the time; leave events.peristalsis at 0")
    make_camera(camera).rays(border_window(config.imaging.border, camera.width, camera.height))
    plan_timeline(config.motion, config.events, config.seed)


def _check_one(name: str, value: Any) -> None:
    """Raise PhantomError unless the value of `section.field` is a known choice or finite and in range."""
    if isinstance(value, bool):
        return
    if isinstance(value, str):
        if name in FREE_TEXT:
            return
        if value not in CHOICES[name]:
            raise PhantomError(f"{name}: unknown {value!r}; known: {', '.join(CHOICES[name])}")
        return
    least, most = RANGES[name]
    for number in value if isinstance(value, tuple) else (value,):
        if not math.isfinite(number):
            raise PhantomError(f"{name}: expected a finite number, got {number}")
        if not least <= number <= most:
            raise PhantomError(f"{name}: {number:g} is not within {least:g} to {most:g}")
