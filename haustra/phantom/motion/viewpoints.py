"""Single viewpoints for training: down the lumen, oblique, facing the wall, and close to it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from haustra.core.errors import PhantomError
from haustra.phantom.anatomy.colon import Colon
from haustra.phantom.motion.camera_path import clearance
from haustra.phantom.raycaster import RayCaster

Array = NDArray[np.float64]

# Share of frames, range of the angle between view and lumen (deg), range of the distance to the wall (mm).
KINDS = {
    "lumen": (0.46, (0.0, 35.0), (4.0, 100.0)),
    "oblique": (0.20, (35.0, 75.0), (4.0, 100.0)),
    "en face": (0.11, (70.0, 110.0), (6.0, 100.0)),
    "close": (0.15, (0.0, 80.0), (2.5, 7.0)),
    "touching": (0.08, (0.0, 60.0), (0.5, 2.5)),
}
TRIES = 200  # draws before the best viewpoint so far is taken
MAX_MISSES = 0.006  # share of the image that may look out of the open ends


def random_viewpoint(colon: Colon, caster: RayCaster, rays: NDArray[np.float32], rng: np.random.Generator) -> Array:
    """Random `world_from_camera` (4,4) inside the lumen; at most MAX_MISSES of `rays` (H,W,3) leave by open ends.

    A kind that this colon has no room for, as touching a wall that no draw came near, gives way to a look down the
    lumen. PhantomError if it has no room for that either.
    """
    names = list(KINDS)
    kind = names[rng.choice(len(names), p=[KINDS[name][0] for name in names])]
    found = _view_of_kind(kind, colon, caster, rays, rng)
    if found is None:
        found = _view_of_kind("lumen", colon, caster, rays, rng)
    if found is None:
        raise PhantomError(f"no view of kind {kind!r} in {TRIES} tries: the lumen is too narrow")
    return found


def _view_of_kind(
    kind: str, colon: Colon, caster: RayCaster, rays: NDArray[np.float32], rng: np.random.Generator
) -> Array | None:
    """The first draw of that kind with few enough misses, or the one with fewest; None if none was of that kind."""
    _, tilts, distances = KINDS[kind]
    probe = rays[:: max(1, rays.shape[0] // 24), :: max(1, rays.shape[1] // 24)].reshape(-1, 3)
    best, fewest = None, np.inf
    for _ in range(TRIES):
        world_from_camera = _draw(colon, tilts, rng)
        if not distances[0] < clearance(colon, caster, world_from_camera[None, :3, 3])[0][0] < distances[1]:
            continue
        hits = caster.cast(world_from_camera[:3, 3], probe @ world_from_camera[:3, :3].T)
        misses = float(np.mean(~hits.valid))
        if misses <= MAX_MISSES:
            return world_from_camera
        if misses < fewest:
            best, fewest = world_from_camera, misses
    return best


def _draw(colon: Colon, tilts: tuple[float, float], rng: np.random.Generator) -> Array:
    """Random `world_from_camera` (4,4) in the lumen, looking either way, tilted by an angle within `tilts` degrees."""
    length = colon.line.arc[-1]
    centre, frame = colon.line.at(np.array(rng.uniform(0.08, 0.92) * length))
    around, out = rng.uniform(0, 2 * np.pi), 0.9 * colon.anatomy.radius_mm * np.sqrt(rng.uniform())
    position = centre + out * (np.cos(around) * frame[:, 0] + np.sin(around) * frame[:, 1])
    if rng.uniform() < 0.5:
        frame = frame @ np.diag([-1.0, 1.0, -1.0])  # look back
    roll, pan = rng.uniform(0, 2 * np.pi, 2)
    tilt = np.radians(rng.uniform(*tilts))
    lean = Rotation.from_rotvec(tilt * np.array([np.cos(pan), np.sin(pan), 0.0]))
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3], world_from_camera[:3, 3] = (
        frame @ (lean * Rotation.from_rotvec([0, 0, roll])).as_matrix(),
        position,
    )
    return world_from_camera
