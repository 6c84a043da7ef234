"""The clip the project carries along: a short withdrawal through three haustra, always the same."""

from __future__ import annotations

from pathlib import Path

from phantom.config import (
    AnatomyConfig,
    AppearanceConfig,
    CameraConfig,
    ImagingConfig,
    MotionConfig,
    PhantomConfig,
)
from phantom.generate import Progress, generate

DEMO = PhantomConfig(
    seed=7,
    anatomy=AnatomyConfig(length_mm=280.0, radius_mm=22.0, fold_depth_mm=7.0),
    appearance=AppearanceConfig(mesh_vessels=0.75, trees_per_cm2=0.05),
    imaging=ImagingConfig(noise=0.004),
    camera=CameraConfig(width=320, height=320, fov_deg=90.1973),  # fx = fy = 159.45 px
    motion=MotionConfig(frames=165, speed_mm=0.48, start=0.6, wobble_mm=4.0, look_deg=10.0),
)
DEMO_CRF = 16  # under 1.2 MB, and feature tracks do not suffer


def write_demo(out_folder: Path, progress: Progress | None = None) -> Path:
    """Film the demo clip into `out_folder` as an RGB-D folder; the clip itself is `video.mp4`."""
    return generate(DEMO, out_folder, progress, crf=DEMO_CRF)
