"""Script of a video before it is rendered: timeline, camera path, motion of the wall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from haustra.phantom.imaging.render import Phantom
from haustra.phantom.motion.camera_path import plan_camera_path
from haustra.phantom.motion.peristalsis import Peristalsis
from haustra.phantom.timeline import Slot, plan_timeline


@dataclass(frozen=True)
class Script:
    """The arguments of `Phantom.film`, in that order."""

    world_from_camera: NDArray[np.float64]  # (N,4,4) mm
    timeline: list[Slot]
    peristalsis: Peristalsis


def write_script(phantom: Phantom) -> Script:
    """Script by a phantom's config. PhantomError if the video is too short or the path leaves the lumen."""
    config, colon = phantom.config, phantom.colon
    timeline = plan_timeline(config.motion, config.events, config.seed)
    world_from_camera = plan_camera_path(colon, phantom.caster, config.motion, config.seed, timeline)
    return Script(world_from_camera, timeline, Peristalsis(colon, config.events, timeline, world_from_camera[:, :3, 3]))
