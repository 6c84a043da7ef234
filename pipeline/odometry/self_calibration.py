"""A guessed lens made better by the map itself: focal length and first radial term, with their standard deviations.

Tracking needs no more than a guess: a focal length that is a sixth off bends the map smoothly. Once the map is there,
one bundle adjustment with the lens free finds it, if the camera moved enough; where it did not, the guess stays.
"""

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.camera import Camera
from pipeline.errors import HaustraError
from pipeline.isolation import run_isolated
from pipeline.odometry.colmap_text import write_model
from pipeline.progress import Progress
from pipeline.submap import Submap

MOST_FRAMES = 100  # that determine the lens, spread over the submap: more cost minutes and add little
MIN_VIEWS = 3  # of a point that takes part; two fit whatever the lens
MAX_FOCAL_SIGMA = 0.03  # of the focal length; depth errs by about as much as the focal length
LOSS_PX = 0.8


@dataclass(frozen=True)
class Lens:
    """camera: refined, or the guess where `determined` is False. sigma: of its refined parameters for one pixel of
    noise, focal length first; NaN where nothing holds them."""

    camera: Camera
    sigma: tuple[float, ...]
    determined: bool


def refine_lens(submap: Submap, camera: Camera, seed: int, scratch: Path, progress: Progress) -> Lens:
    """Adjust `submap` with the lens free; the guess comes back if that fails or the motion does not determine it."""
    unknown = Lens(camera, (float("nan"),), False)
    thin = thinned(submap, MOST_FRAMES)
    if len(thin.frames) < MIN_VIEWS or len(thin.points) == 0:
        return unknown
    folder = scratch / "lens"
    write_model(thin, camera, folder)
    job = {"model": str(folder), "output": str(folder / "lens.json"), "loss_px": LOSS_PX, "seed": seed}
    try:
        run_isolated("pipeline.colmap_worker", "calibrate", job, scratch / "lens.log", "lens", progress)
    except HaustraError as error:
        progress.say(f"{error}; the guessed lens stays")
        return unknown
    found = json.loads((folder / "lens.json").read_text())
    params, sigma = tuple(map(float, found["params"])), tuple(map(float, found["sigma"]))
    determined = (
        all(map(math.isfinite, params)) and params[0] > 0 and sigma[0] <= MAX_FOCAL_SIGMA * params[0]  # NaN: False
    )
    return Lens(replace(camera, params=params) if determined else camera, sigma, determined)


def thinned(submap: Submap, most: int) -> Submap:
    """At most so many of its frames, spread evenly, and the points that enough of them see."""
    rows = np.unique(np.linspace(0, len(submap.frames) - 1, most).round().astype(int))
    dropped = np.setdiff1d(np.arange(len(submap.frames)), rows)
    few = submap.without_frames(set(submap.frames[dropped].tolist()))
    return _without_points(few, few.track_lengths() < MIN_VIEWS)


def _without_points(submap: Submap, drop: NDArray[np.bool_]) -> Submap:
    mine = ~drop[submap.observations[:, 1]]
    observations = submap.observations[mine].copy()
    observations[:, 1] = (np.cumsum(~drop) - 1)[observations[:, 1]]
    return replace(
        submap,
        points=submap.points[~drop],
        error_px=submap.error_px[~drop],
        observations=observations,
        pixels=submap.pixels[mine],
    )
