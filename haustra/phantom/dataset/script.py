"""Script of a video before it is rendered: timeline, camera path, motion of the wall."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from haustra.phantom.imaging.render import Phantom
from haustra.phantom.motion.camera_path import plan_camera_path
from haustra.phantom.motion.living_wall import LivingWall
from haustra.phantom.motion.peristalsis import Peristalsis
from haustra.phantom.motion.recorded_path import read_recording, replay
from haustra.phantom.timeline import Slot, plan_timeline


@dataclass(frozen=True)
class Script:
    """The arguments of `Phantom.film`, in that order."""

    world_from_camera: NDArray[np.float64]  # (N,4,4) mm
    timeline: list[Slot]
    wall: Peristalsis | LivingWall


def write_script(phantom: Phantom, recordings: Path = Path()) -> Script:
    """Script by a phantom's config; `recordings` is the folder of the paths that configs name.

    PhantomError if the video is too short, the path leaves the lumen, or a recording cannot be read.
    """
    config, colon, motion = phantom.config, phantom.colon, phantom.config.motion
    timeline = plan_timeline(motion, config.events, config.seed)
    if motion.recording:
        recording = read_recording(recordings / motion.recording)
        world_from_camera = replay(colon, phantom.caster, motion, *recording)
    else:
        world_from_camera = plan_camera_path(colon, phantom.caster, motion, config.seed, timeline)
    positions = world_from_camera[:, :3, 3]
    if config.tissue.amplitude_mm:
        return Script(world_from_camera, timeline, LivingWall(colon, config.tissue, positions, motion.fps, config.seed))
    return Script(world_from_camera, timeline, Peristalsis(colon, config.events, timeline, positions))
