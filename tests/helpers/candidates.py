"""Submaps as front ends' scoring sees them, of which only frames and lighting are asked."""

from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from pipeline.frontend.scoring import Candidate
from pipeline.frontend.second_opinion import MARGIN, Stretch
from pipeline.input.frames import Frames
from pipeline.mapping.lighting_check import LightingCheck
from tests.helpers.tubes.textured_tube import CAMERA

NINETY = SimpleNamespace(frames=np.arange(90), camera_params=(200.0,))
GOOD = Candidate(NINETY, LightingCheck(90, 600, 0.5, 5.0, -0.9, 0.0, 90), Path(), "odometry")
DARK = Candidate(NINETY, LightingCheck(90, 600, 0.3, 5.0, -0.2, 0.4, 90), Path(), "odometry")


def many_frames(count):
    """So many working frames at 30 a second."""
    index = np.arange(count)
    return Frames(index, index / 30.0, CAMERA, np.ones((CAMERA.height, CAMERA.width), np.uint8), {"used": count})


def map_of(frames, inconsistent=0.0, mapper="odometry"):
    """A candidate that poses these frames."""
    frames = np.asarray(frames)
    return Candidate(
        SimpleNamespace(frames=frames, camera_params=(200.0,)),
        LightingCheck(len(frames), 600, 0.5, 5.0, -0.9, inconsistent, len(frames)),
        Path(),
        mapper,
    )


def stretch_of(begin, end, margin=MARGIN):
    """What is in doubt from one frame to another, and some frames around it."""
    index = np.arange(max(0, begin - margin), end + margin)
    return Stretch(replace(many_frames(len(index)), index=index, seconds=index / 30), np.arange(begin, end))


@dataclass(frozen=True)
class Given:
    """What is asked of a submap."""

    frames: np.ndarray
    camera_sigma: tuple[float, ...] = ()
    camera_params: tuple[float, ...] = (200.0,)

    def without_frames(self, gone):
        return replace(self, frames=np.array([frame for frame in self.frames if frame not in gone]))
