"""Named scenes: the four rows of the paper's Table I, each with a stand-in whose truth is known.

colon            photoreal colon, the VR-Caps colon's place
small_intestine  narrow, little texture, ringed by plicae and covered by villi: the VR-Caps small intestine's place
ccd              two materials under two lights, taken in turn by the seed (UCL's Colonoscopy CG Dataset)
csd              poor light, rich vessels (the Colonoscopy Simulator Dataset)

They resemble those data sets in kind; no picture or mesh of them went in.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from haustra.core.errors import PhantomError
from haustra.phantom.appearance.presets import CAPSULE, DIM, ORANGE, PALE, PINK, SCOPE, SPOT, VEINED, VILLOUS, WIDE
from haustra.phantom.config import AnatomyConfig, MotionConfig, PhantomConfig

COLON = PhantomConfig(
    anatomy=AnatomyConfig(pedunculated=1, flat=1, diverticula=2),
    appearance=PINK,
    imaging=SCOPE,
)
SMALL_INTESTINE = PhantomConfig(
    anatomy=AnatomyConfig(
        scene="small_intestine",
        length_mm=220.0,
        radius_mm=13.0,
        taenia_depth_mm=0.0,
        sacculation_mm=0.3,
        fold_spacing_mm=7.5,
        fold_depth_mm=3.0,
        fold_width_mm=1.2,
        fold_tilt_mm=1.5,
        relief_mm=0.25,
        villi_mm=0.12,
        polyps=1,
        polyp_radius_mm=2.0,
        edge_mm=0.6,
    ),
    appearance=VILLOUS,
    imaging=CAPSULE,
    motion=MotionConfig(speed_mm=0.3, wobble_mm=2.0, ahead_mm=14.0, clearance_mm=2.5),
)
MATERIALS, LIGHTS = (ORANGE, PALE), (SPOT, WIDE)
CSD = replace(COLON, appearance=VEINED, imaging=DIM)
SCENES = ("colon", "small_intestine", "ccd", "csd")
USABLE = 0.5  # share of the gut that a path may cover: the view reaches some 100 mm further, and ends are contracted
MARGIN = 0.12  # share of the gut at either end that a path keeps out of
MAX_LENGTH_MM = 1200.0  # of a gut lengthened for its path; an adult's colon is about 1500 mm long


def scene_config(name: str, seed: int = 0) -> PhantomConfig:
    """The config of a named scene. PhantomError if the name is unknown."""
    if not isinstance(name, str) or name not in SCENES:
        raise PhantomError(f"unknown scene {name!r}; known: {', '.join(SCENES)}")
    if name == "ccd":
        material, light = divmod(seed % 4, 2)
        return replace(COLON, seed=seed, appearance=MATERIALS[material], imaging=LIGHTS[light])
    known = {"colon": COLON, "small_intestine": SMALL_INTESTINE, "csd": CSD}
    return replace(known[name], seed=seed)


def film_of(
    config: PhantomConfig, frames: int | None = None, size: int | None = None, direction: str | None = None
) -> PhantomConfig:
    """The same scene filmed for longer, larger or the other way.

    A way that no longer fits the lumen begins elsewhere, in a gut as long as it needs; beyond
    MAX_LENGTH_MM the scope goes slower instead. A way that fits is left as it is.
    """
    camera, motion, anatomy = config.camera, config.motion, config.anatomy
    if size is not None:
        camera = replace(camera, width=size, height=size)
    if frames is not None:
        motion = replace(motion, frames=frames)
    if direction is not None:
        motion = replace(motion, direction=direction)
    if frames is None and direction is None:
        return replace(config, camera=camera)
    if not fits(motion, anatomy.length_mm):
        motion, anatomy = _room_for(motion, anatomy)
    return replace(config, camera=camera, motion=motion, anatomy=anatomy)


def _way_mm(motion: MotionConfig) -> float:
    """Largest distance (mm) that a path may get from its start."""
    there_and_back = 2 if motion.direction == "loop" else 1
    return motion.speed_mm * (1 + motion.speed_variation) * motion.frames / there_and_back


def fits(motion: MotionConfig, length_mm: float) -> bool:
    """True if the way stays clear of both contracted ends."""
    sign = -1 if motion.direction == "withdrawal" else 1
    end = motion.start + sign * _way_mm(motion) / length_mm
    return min(motion.start, end) >= MARGIN and max(motion.start, end) <= 1 - MARGIN


def _room_for(motion: MotionConfig, anatomy: AnatomyConfig) -> tuple[MotionConfig, AnatomyConfig]:
    """Motion and anatomy changed so that the path fits: a longer gut, another start, a lower speed."""
    way_mm = _way_mm(motion)
    length_mm = float(np.clip(way_mm / USABLE, anatomy.length_mm, max(MAX_LENGTH_MM, anatomy.length_mm)))
    slower = min(1.0, USABLE * length_mm / max(way_mm, 1e-9))
    start = 0.5 + USABLE / 2 if motion.direction == "withdrawal" else 0.5 - USABLE / 2
    motion = replace(motion, start=start, speed_mm=motion.speed_mm * slower)
    return motion, replace(anatomy, length_mm=length_mm)
