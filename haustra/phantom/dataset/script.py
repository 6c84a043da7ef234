"""What a film will show, before it is shot: when things happen, where the camera goes, how the wall moves."""

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
    """A phantom's film as its config wants it: what `Phantom.film` takes, in that order."""

    world_from_camera: NDArray[np.float64]  # (N,4,4) mm
    timeline: list[Slot]
    peristalsis: Peristalsis


def write_script(phantom: Phantom) -> Script:
    """Raises PhantomError where the film is too short for its slots, or the path leaves the lumen."""
    config, colon = phantom.config, phantom.colon
    timeline = plan_timeline(config.motion, config.events, config.seed)
    world_from_camera = plan_camera_path(colon, phantom.caster, config.motion, config.seed, timeline)
    return Script(world_from_camera, timeline, Peristalsis(colon, config.events, timeline, world_from_camera[:, :3, 3]))
