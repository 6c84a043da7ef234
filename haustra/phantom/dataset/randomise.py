"""Domain randomisation: phantoms that differ as much as patients, scopes and processors do.

Ranges go a little beyond the plausible, so that plausible cases lie inside the training distribution.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from haustra.core.errors import PhantomError
from haustra.phantom.config import (
    AnatomyConfig,
    AppearanceConfig,
    CameraConfig,
    Colour,
    ImagingConfig,
    MotionConfig,
    PhantomConfig,
)
from haustra.phantom.imaging.camera import make_camera


def randomised(rng: np.random.Generator, size: int = 320, scene: str | None = None) -> PhantomConfig:
    """A random phantom. `size` is the square image's side in px; `scene` fixes the anatomy's kind."""
    kind = scene or ("small_intestine" if rng.uniform() < 0.2 else "colon")
    anatomy = random_small_intestine(rng) if kind == "small_intestine" else random_colon(rng)
    return PhantomConfig(
        seed=int(rng.integers(2**31)),
        anatomy=anatomy,
        appearance=random_appearance(rng),
        imaging=random_imaging(rng),
        camera=random_camera(rng, size),
        motion=random_motion(rng, anatomy),
    )


def random_colon(rng: np.random.Generator) -> AnatomyConfig:
    """From a spastic sigmoid to a wide caecum."""
    radius = rng.uniform(13.0, 29.0)
    depth = rng.uniform(0.1, 0.5) * radius
    return AnatomyConfig(
        scene="colon",
        length_mm=260.0,
        radius_mm=radius,
        radius_variation=rng.uniform(0.03, 0.25),
        bend=rng.uniform(0.2, 0.75),
        flexures=int(rng.integers(0, 4)),
        taenia_depth_mm=rng.uniform(0.0, 0.16) * radius,
        taenia_twist_deg_per_mm=rng.uniform(-0.5, 0.5),
        sacculation_mm=rng.uniform(0.0, 0.15) * radius,
        fold_spacing_mm=rng.uniform(12.0, 40.0),
        fold_spacing_jitter=rng.uniform(0.1, 0.5),
        fold_depth_mm=depth,
        fold_depth_jitter=rng.uniform(0.1, 0.6),
        fold_width_mm=max(rng.uniform(1.2, 4.5), 0.22 * depth),
        fold_edge_mm=rng.uniform(0.6, 1.6),
        fold_tilt_mm=rng.uniform(0.0, 8.0),
        fold_lean=rng.uniform(0.0, 0.8),
        relief_mm=rng.uniform(0.1, 1.1),
        polyps=int(rng.integers(0, 7)),
        polyp_radius_mm=rng.uniform(1.5, 5.0),
        pedunculated=int(rng.integers(0, 3)),
        flat=int(rng.integers(0, 3)),
        diverticula=int(rng.integers(0, 4)) if rng.uniform() < 0.25 else 0,
        diverticulum_mm=rng.uniform(1.8, 4.0),
        collapse=_sometimes(rng, 0.2, 0.1, 0.5),
        closed_start=bool(rng.uniform() < 0.25),
        closed_end=bool(rng.uniform() < 0.25),
        edge_mm=0.9,
    )


def random_small_intestine(rng: np.random.Generator) -> AnatomyConfig:
    """Narrow, without taeniae, ringed by plicae circulares."""
    radius = rng.uniform(9.0, 15.0)
    depth = rng.uniform(0.12, 0.35) * radius
    return replace(
        random_colon(rng),
        scene="small_intestine",
        length_mm=190.0,
        radius_mm=radius,
        taenia_depth_mm=0.0,
        sacculation_mm=rng.uniform(0.0, 0.8),
        fold_spacing_mm=rng.uniform(4.5, 11.0),
        fold_depth_mm=depth,
        fold_width_mm=max(rng.uniform(0.9, 1.6), 0.3 * depth),
        fold_tilt_mm=rng.uniform(0.0, 2.5),
        relief_mm=rng.uniform(0.05, 0.4),
        polyp_radius_mm=rng.uniform(1.0, 3.0),
        diverticula=0,
        villi_mm=_sometimes(rng, 0.7, 0.05, 0.4),
        edge_mm=0.7,
    )


def _sometimes(rng: np.random.Generator, chance: float, low: float, high: float) -> float:
    """A number between low and high with probability `chance`, else 0; draws the same count either way."""
    value = rng.uniform(low, high)
    return float(value) if rng.uniform() < chance else 0.0


def _tissue(rng: np.random.Generator) -> Colour:
    """Reflectance from reddish to orange to pale; in 8 % any colour, so that colour alone is no cue."""
    red = rng.uniform(0.45, 0.85)
    green = red * rng.uniform(0.22, 0.62)
    blue = green * rng.uniform(0.35, 1.05)
    if rng.uniform() < 0.08:
        red, green, blue = rng.uniform(0.1, 0.9, 3)
    return float(red), float(green), float(blue)


def random_appearance(rng: np.random.Generator) -> AppearanceConfig:
    """From bare smooth mucosa to rich vessels."""
    tissue = _tissue(rng)
    other = tuple(float(np.clip(c * rng.uniform(0.75, 1.35), 0.05, 0.95)) for c in tissue)
    vessel = rng.uniform((0.35, 0.15, 0.2), (0.85, 0.6, 0.7))
    return AppearanceConfig(
        tissue=tissue,
        tissue_other=(other[0], other[1], other[2]),
        blotch_mm=rng.uniform(6.0, 35.0),
        mottle=rng.uniform(0.01, 0.16),
        grain=rng.uniform(0.005, 0.08),
        erythema=rng.uniform(0.0, 0.6),
        vessel_colour=(float(vessel[0]), float(vessel[1]), float(vessel[2])),
        mesh_vessels=rng.uniform(0.2, 1.0) * (rng.uniform() < 0.65),
        mesh_cell_mm=rng.uniform(5.0, 16.0),
        mesh_width_mm=rng.uniform(0.25, 0.9),
        tree_vessels=rng.uniform(0.2, 1.0) * (rng.uniform() < 0.75),
        trees_per_cm2=float(np.exp(rng.uniform(np.log(0.02), np.log(0.4)))),
        tree_width_mm=rng.uniform(0.25, 0.9),
        bump_mm=float(np.exp(rng.uniform(np.log(0.002), np.log(0.03)))),
        cavity=rng.uniform(0.0, 0.6),
        stool=_sometimes(rng, 0.25, 0.02, 0.35),
        stool_colour=_stool_colour(rng),
        fluid=_sometimes(rng, 0.25, 0.05, 0.4),
        fluid_colour=_fluid_colour(rng),
        texel_mm=0.2,
    )


def _stool_colour(rng: np.random.Generator) -> Colour:
    """Ochre to brown, bile makes it greenish."""
    red = rng.uniform(0.15, 0.6)
    green = red * rng.uniform(0.45, 0.85)
    return float(red), float(green), float(green * rng.uniform(0.1, 0.5))


def _fluid_colour(rng: np.random.Generator) -> Colour:
    """Transmittance of a film of fluid: clear, yellow, greenish, or bloody."""
    red = rng.uniform(0.5, 1.0)
    green = red * rng.choice([rng.uniform(0.7, 1.1), rng.uniform(0.2, 0.5)], p=[0.85, 0.15])
    return float(red), float(min(green, 1.0)), float(min(green, 1.0) * rng.uniform(0.2, 0.9))


def random_imaging(rng: np.random.Generator) -> ImagingConfig:
    """Light guides, exposure and processing of unlike scopes."""
    warmth = rng.uniform(0.75, 1.1)
    return ImagingConfig(
        lights=int(rng.integers(1, 4)),
        light_offset_mm=rng.uniform(0.5, 6.0),
        light_roll_deg=rng.uniform(0.0, 360.0),
        light_lobe=float(np.clip(rng.normal(2.5, 0.7), 1.2, 4.5) if rng.uniform() < 0.75 else rng.uniform(0.0, 1.5)),
        lobe_tilt_deg=float(abs(rng.normal(0.0, 4.0))),
        lobe_roll_deg=rng.uniform(0.0, 360.0),
        light_colour=(1.0, float(rng.uniform(0.9, 1.05)), float(warmth)),
        ambient=float(np.exp(rng.uniform(np.log(0.03), np.log(0.6)))),
        bounce=rng.uniform(0.3, 2.0) * (rng.uniform() < 0.7),
        wrap=rng.uniform(0.0, 0.3),
        shadows=bool(rng.uniform() < 0.5),
        specular=rng.uniform(0.0, 0.4) * (rng.uniform() < 0.85),
        shininess=float(np.exp(rng.uniform(np.log(15.0), np.log(300.0)))),
        exposure=rng.uniform(0.07, 0.32),
        gain_error=_gain_error(rng),
        crosstalk=_sometimes(rng, 0.6, 0.2, 0.9),
        gamma=rng.uniform(1.8, 2.5),
        vignette=rng.uniform(0.0, 0.6),
        border=str(rng.choice(["none", "circle", "octagon"], p=[0.75, 0.1, 0.15])),
        noise=rng.uniform(0.0, 0.03),
        blur_px=float(rng.choice([0.0, rng.uniform(0.3, 1.2)], p=[0.2, 0.8])),
        shutter=float(rng.choice([0.0, rng.uniform(0.2, 1.0)], p=[0.8, 0.2])),
        focus_mm=float(np.exp(rng.uniform(np.log(8.0), np.log(40.0)))),
        defocus_px=_sometimes(rng, 0.3, 0.2, 1.5),
        sharpen=_sometimes(rng, 0.4, 0.2, 1.5),
        chroma_px=2 if rng.uniform() < 0.6 else 1,
        jpeg_quality=int(rng.integers(40, 96)) if rng.uniform() < 0.5 else 0,
        text=bool(rng.uniform() < 0.1),
    )


def _gain_error(rng: np.random.Generator) -> float:
    """How far an automatic gain that lags is from the right one, or a fixed one: right in half of the frames, in the
    others up to eight times too high, which burns all that is near, or a fifth, which starves all that is far."""
    error = float(np.exp(np.clip(rng.normal(0.35, 0.8), np.log(0.2), np.log(8.0))))
    return error if rng.uniform() < 0.5 else 1.0


def random_camera(rng: np.random.Generator, size: int) -> CameraConfig:
    """80 to 150 degrees; mostly rectified images, some with barrel distortion, some fisheyes, of which most are drawn
    around 18 measured colonoscopes. Never folds over."""
    while True:
        config = _any_camera(rng, size)
        try:
            make_camera(config).rays()
        except PhantomError:
            continue
        return config


def _any_camera(rng: np.random.Generator, size: int) -> CameraConfig:
    """A random lens, which may fold over inside the image."""
    kind = rng.choice(["PINHOLE", "OPENCV", "OPENCV_FISHEYE"], p=[0.75, 0.10, 0.15])
    fov = rng.uniform(80.0, 120.0) if kind != "OPENCV_FISHEYE" else rng.uniform(90.0, 150.0)
    distortion = (0.0, 0.0, 0.0, 0.0)
    if kind == "OPENCV":
        fov = rng.uniform(75.0, 93.0)  # wider or bent more, the polynomial folds over in the corners
        distortion = (float(rng.uniform(-0.05, 0.04)), float(rng.uniform(0.0, 0.005)), 0.0, 0.0)
    if kind == "OPENCV_FISHEYE":
        if rng.uniform() < 0.7:  # Kannala-Brandt terms of the measured ones: mean and twice their spread
            distortion = (float(rng.normal(-0.123, 0.014)), float(rng.normal(-0.008, 0.006)), 0.0019, -0.00009)
        else:
            distortion = (float(rng.uniform(-0.05, 0.05)), float(rng.uniform(-0.01, 0.01)), 0.0, 0.0)
    return CameraConfig(str(kind), size, size, float(fov), distortion)


def random_motion(rng: np.random.Generator, anatomy: AnatomyConfig) -> MotionConfig:
    """Calm to hurried, both ways, over at most half the lumen: the contracted ends stay out of reach."""
    direction = str(rng.choice(["withdrawal", "insertion"]))
    frames = 160
    return MotionConfig(
        frames=frames,
        direction=direction,
        start=0.72 if direction == "withdrawal" else 0.25,
        speed_mm=rng.uniform(0.15, 0.45) * anatomy.length_mm / frames,
        speed_variation=rng.uniform(0.0, 0.5),
        wobble_mm=rng.uniform(0.05, 0.5) * anatomy.radius_mm,
        wobble_period=rng.uniform(40.0, 120.0),
        look_deg=rng.uniform(3.0, 30.0),
        roll_deg=rng.uniform(0.0, 25.0),
        ahead_mm=rng.uniform(0.7, 1.6) * anatomy.radius_mm,
        clearance_mm=min(3.5, 0.2 * anatomy.radius_mm),
    )
