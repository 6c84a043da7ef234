"""Camera motion by a depth sensor's clouds alone, each registered to the wall that was seen so far.

The wall is that of the frames of known poses and of the latest clouds that were registered themselves, so that it goes
on where the camera turns away from what it knew. Its errors add up: toward wall that was never seen it drifts along the
lumen, toward wall that was seen it does not.
"""

from itertools import pairwise

import numpy as np

from haustra.core.se3 import Array, in_camera, inverse, motion_of, tangent_of
from pipeline.frontend.odometry.bridging.cloud_registration import WallPatches
from pipeline.frontend.odometry.bridging.depth_clouds import Clouds, joint_cloud

PACE = 8  # frames of known poses over which the first velocity is measured
OVER = 6  # frames over which the later ones are
MOST_UNSEEN = 3  # frames in a row that are not registered: beyond, a way is a guess
KEPT = 8  # latest clouds that are part of the wall


def followed(world_from_camera: dict[int, Array], frame: int, last: int, clouds: Clouds) -> Array | None:
    """world_from_camera (4,4) of frame `last` by depth odometry, forwards or backwards from `frame` of known pose; None
    where the sensor saw too little of the wall around it, or in more than `MOST_UNSEEN` frames in a row."""
    step = 1 if last > frame else -1
    known = joint_cloud(world_from_camera, frame, -step, clouds)
    if known is None:
        return None
    wall = WallPatches.of(in_camera(world_from_camera[frame], known))
    poses = dict(world_from_camera)
    recent: list[Array] = []
    velocity = step * pace(world_from_camera, frame, -step * PACE)
    unseen = 0
    for now in range(frame + step, last + step, step):
        guess = poses[now - step] @ motion_of(velocity)
        cloud = clouds(now)
        found = None
        if cloud is not None:
            whole = wall.joined(WallPatches.of(np.concatenate(recent))) if recent else wall
            found = whole.registered(cloud, guess)
        if cloud is not None and found is not None:
            recent = [*recent, in_camera(found, cloud)][-KEPT:]
            unseen = 0
        else:
            unseen += 1
        if unseen > MOST_UNSEEN:
            return None
        poses[now] = guess if found is None else found
        latest = [now - back * step for back in range(OVER, -1, -1) if now - back * step in poses]
        velocity = mean_motion(poses, latest)
    return poses[last]


def by_velocity(here: dict[int, Array], there: dict[int, Array]) -> Array:
    """world_from_camera (4,4) of the first frame of `there` in the world of `here`, from a velocity that goes over from
    that before the gap to that after it."""
    end, begin = max(here), min(there)
    world_from_camera, leaving, coming = here[end], pace(here, end, -PACE), pace(there, begin, PACE)
    for frame in range(end + 1, begin + 1):
        share = (frame - end - 0.5) / (begin - end)
        world_from_camera = world_from_camera @ motion_of((1 - share) * leaving + share * coming)
    return world_from_camera


def pace(world_from_camera: dict[int, Array], frame: int, steps: int) -> Array:
    """Motion (6,) of one frame forwards, in the camera's axes, over `steps` frames from `frame` on."""
    known = [other for other in world_from_camera if 0 <= (other - frame) * np.sign(steps) <= abs(steps)]
    return mean_motion(world_from_camera, sorted(known))


def mean_motion(world_from_camera: dict[int, Array], frames: list[int]) -> Array:
    """Motion (6,) of one frame, in the camera's own axes, of some frames in order; 0 of fewer than two."""
    if len(frames) < 2:
        return np.zeros(6)
    steps = [tangent_of(inverse(world_from_camera[one]) @ world_from_camera[other]) for one, other in pairwise(frames)]
    return np.asarray(np.sum(steps, axis=0) / abs(frames[-1] - frames[0]))
