"""Constant velocity from frame to frame: where the next pose is looked for."""

from haustra.core.se3 import Array, inverse, share_of

MAX_GAP = 3  # frames over which the motion is carried on


def velocity_between(before: Array, now: Array, steps: int) -> Array:
    """Motion (4,4) in one frame interval of a camera that came from camera_from_world `before` to `now` in so many."""
    motion = now @ inverse(before)
    return motion if steps == 1 else share_of(motion, 1 / steps)


def predicted_pose(camera_from_world: Array, velocity: Array, steps: int) -> Array:
    """camera_from_world (4,4) so many frame intervals later; as it is where they are more than `MAX_GAP`."""
    for _ in range(steps if steps <= MAX_GAP else 0):
        camera_from_world = velocity @ camera_from_world
    return camera_from_world
