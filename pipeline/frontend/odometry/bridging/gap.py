"""Maps joined over a stretch that shows nothing, by what a sensor measured in it.

A burnt, blurred or covered second ends a map, and the next begins in a world of its own. Where both are in millimetres,
clouds between them are registered to those of the last good frames (`cloud_registration`), from a
velocity that goes from the one that the first map ends with to the one that the second begins with. What a tube leaves
free, the turn about its axis and the way along it, stays with that velocity.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from haustra.core.progress import Progress
from haustra.core.ray_table import RayTable
from haustra.core.se3 import Array, compose, exp_rotation, in_camera, inverse
from pipeline.frontend.odometry.bridging.cloud_registration import WallPatches
from pipeline.frontend.odometry.chunk_stitching import frame_observations, stitch
from pipeline.input.sensor.sensor_depth import SensorDepth
from pipeline.mapping.final_adjustment import adjust_to_features
from pipeline.mapping.local_map import LocalMap
from pipeline.matching.sift import FindFeatures

Clouds = Callable[[int], Array | None]  # (N,3) of a frame, mm, in the camera's axes
MOST_FRAMES = 60  # of a gap: two seconds
REACH, STEP = 40, 4  # frames on either side of the gap that are taken together, and how far apart
EVERY = 3  # frames of the gap, of which one is registered
PACE = 8  # frames over which a velocity is measured
MOST_POINTS, FARTHEST_MM = 1500, 80.0  # of a cloud
FEWEST_POINTS = 200
# Chosen on 31 gaps of five films of coverage_films.yaml. Poses within 2 mm and 5 deg of the truth have 0.8 to 1.5 times
# the usual distance; those of the others that come out so lie below a share of 0.75 or differ from the way back.
MOST_WORSE = 1.6  # times as far from the wall as a cloud of either side lies from its own, and it does not belong there
LEAST_SHARE = 0.3  # of the first cloud after the gap that lies where wall was seen before it
LEAST_SHARE_TURNED = 0.75  # the same of a further guess: with less overlap many a turn fits
MOST_TURN, MOST_SHIFT_MM = np.radians(6.0), 2.5  # between the way over the gap and the way back
TURNS = np.radians(np.arange(-32.0, 33.0, 8.0))  # about the camera's axis, of further guesses
MOST_COMPARED = 4000  # points by which the guesses are compared


def clouds_of(sensor: SensorDepth, rays: RayTable) -> Clouds:
    """Thinned evenly; None for a frame of which the sensor saw too little."""

    def cloud(frame: int) -> Array | None:
        found = sensor.cells(frame)
        if found is None:
            return None
        pixels, depth, _ = found
        near = (depth < FARTHEST_MM) & (pixels >= 0).all(axis=1)
        near &= (pixels < [rays.camera.width, rays.camera.height]).all(axis=1)
        step = max(1, int(near.sum()) // MOST_POINTS)
        pixels, depth = pixels[near][::step], depth[near][::step]
        if len(depth) < FEWEST_POINTS:
            return None
        return np.asarray(np.column_stack([rays.unproject(pixels)[0], np.ones(len(depth))]) * depth[:, None])

    return cloud


def bridge_maps(
    maps: list[LocalMap], clouds: Clouds, find: FindFeatures, progress: Progress
) -> tuple[list[LocalMap], int]:
    """Metric maps that follow one another joined where the sensor shows the way, then adjusted to their features; how
    many were. Where features do not hold the whole, the parts stay as they are, in one world."""
    result: list[LocalMap] = []
    count = 0
    for local_map in sorted(maps, key=lambda m: min(m.frames)):
        before = result[-1] if result else None
        moved = None if before is None else first_from_second(before, local_map, clouds)
        if before is None or moved is None:
            result.append(local_map)
            continue
        gap = min(local_map.frames) - max(before.frames)
        whole = _joined(copy.deepcopy(before), copy.deepcopy(local_map), moved)
        by = adjust_to_features(whole, find)
        first, held = (
            min(local_map.frames),
            "" if by is not None else "; too few features agree to adjust it",
        )
        progress.log(f"submap from frame {first} on joined to the one before over {gap} frames by depth{held}")
        result[-1], count = whole, count + 1
    return result, count


def first_from_second(first: LocalMap, second: LocalMap, clouds: Clouds) -> Array | None:
    """The second world in the first (4,4), both mm; None where the gap is long, or the clouds do not fit."""
    if first.depth_at is None or second.depth_at is None:
        return None
    here, there = (poses_of(local_map) for local_map in (first, second))
    world_from_camera = registered_over_gap(here, there, clouds)
    return None if world_from_camera is None else np.asarray(world_from_camera @ inverse(there[min(there)]))


def registered_over_gap(here: dict[int, Array], there: dict[int, Array], clouds: Clouds) -> Array | None:
    """world_from_camera (4,4) of the first frame of `there` in the world of `here`, poses by frame; None where the gap
    is long, the clouds overlap too little or do not fit, or the way back is another one."""
    end, begin = max(here), min(there)
    if not 0 < begin - end <= MOST_FRAMES or min(len(here), len(there)) <= PACE:
        return None
    sides = _Sides.of(here, there, clouds)
    if sides is None:
        return None
    wall = WallPatches.of(in_camera(here[end], sides.before))

    def registered(frame: int, guess: Array) -> Array:
        cloud = clouds(frame) if (begin - frame) % EVERY == 0 else None
        return guess if cloud is None else wall.registered(cloud, guess)

    followed = _followed(here, there, registered)
    found = sides.checked(wall, here[end], _best_of_turns(wall, sides.after, followed), LEAST_SHARE_TURNED)
    if found is None:
        found = sides.checked(wall, here[end], wall.registered(sides.after, followed))
    return found


def _best_of_turns(wall: WallPatches, cloud: Array, guess: Array) -> Array:
    """The best of registrations from a guess and from it turned about the camera's axis: in a tube that turn slips
    first, and a registration finds it within some ten degrees alone."""
    few = cloud[:: max(1, len(cloud) // MOST_COMPARED)]
    tried = [wall.registered(few, guess @ _motion(np.array([0, 0, turn, 0, 0, 0]))) for turn in TURNS]
    return wall.registered(cloud, min(tried, key=lambda pose: wall.misfit(few, pose)))


@dataclass(frozen=True)
class _Sides:
    """Clouds on both sides of a gap, each in the axes of its frame next to the gap, mm: of the frames before (N,3), of
    those after (M,3), and of the first one after (K,3); usual: how far such a one lies from those beside it."""

    before: Array
    after: Array
    first: Array
    usual: float

    @staticmethod
    def of(here: dict[int, Array], there: dict[int, Array], clouds: Clouds) -> "_Sides | None":
        """None where the sensor saw too little, or the clouds of one side have nothing in common."""
        end, begin = max(here), min(there)
        before, last = joint_cloud(here, end, -1, clouds, least=STEP), clouds(end)
        after, first = joint_cloud(there, begin, 1, clouds, least=STEP), clouds(begin)
        if before is None or last is None or after is None or first is None:
            return None
        off = [WallPatches.of(joint).fit(one, np.eye(4))[0] for joint, one in ((before, last), (after, first))]
        if not np.isfinite(off).all():
            return None
        return _Sides(np.concatenate([before, last]), np.concatenate([first, after]), first, max(off))

    def checked(
        self, wall: WallPatches, last_pose: Array, found: Array, least_share: float = LEAST_SHARE
    ) -> Array | None:
        """The middle of `found`, world_from_camera (4,4) of the first frame after the gap, and of the way back from
        there; None where the two differ, or the first cloud does not lie on the wall from before the gap."""
        back = WallPatches.of(self.after).registered(self.before, inverse(found) @ last_pose)
        apart = inverse(found) @ last_pose @ inverse(back)  # of the first frame, by the way back, from its pose
        turn, shift = _tangent(apart)[:3], apart[:3, 3]
        off, share = wall.fit(self.first, found)
        if np.linalg.norm(turn) > MOST_TURN or np.linalg.norm(shift) > MOST_SHIFT_MM:
            return None
        if off > MOST_WORSE * self.usual or share < least_share:
            return None
        return np.asarray(found @ _motion(_tangent(apart) / 2))


def velocity_over_gap(here: dict[int, Array], there: dict[int, Array]) -> Array:
    """world_from_camera (4,4) of the first frame of `there` by the velocity alone."""
    return _followed(here, there, lambda _, predicted: predicted)


def _followed(here: dict[int, Array], there: dict[int, Array], corrected: Callable[[int, Array], Array]) -> Array:
    """The pose after the gap, frame by frame from a velocity that goes from that before it to that after it."""
    end, begin = max(here), min(there)
    world_from_camera, leaving, coming = here[end], _pace(here, end, -PACE), _pace(there, begin, PACE)
    for frame in range(end + 1, begin + 1):
        share = (frame - end - 0.5) / (begin - end)
        world_from_camera = corrected(frame, world_from_camera @ _motion((1 - share) * leaving + share * coming))
    return world_from_camera


def joint_cloud(
    world_from_camera: dict[int, Array], frame: int, direction: int, clouds: Clouds, least: int = 0
) -> Array | None:
    """Clouds (N,3) of a frame and those up to `REACH` after or before it, one in `STEP`, in the frame's axes."""
    others = [frame + direction * step for step in range(least, REACH + 1, STEP)]
    seen = [
        in_camera(inverse(world_from_camera[frame]) @ world_from_camera[other], cloud)
        for other in others
        if other in world_from_camera and (cloud := clouds(other)) is not None
    ]
    return np.concatenate(seen) if seen else None


def poses_of(local_map: LocalMap) -> dict[int, Array]:
    """world_from_camera (4,4) by frame."""
    return {frame: inverse(seen.camera_from_world) for frame, seen in frame_observations(local_map).items()}


def _pace(world_from_camera: dict[int, Array], frame: int, steps: int) -> Array:
    """Motion (6,) of one frame, in the camera's axes, over `steps` frames from `frame` on."""
    known = [other for other in world_from_camera if 0 < (other - frame) * np.sign(steps) <= abs(steps)]
    other = max(known, key=lambda k: abs(k - frame), default=frame)
    if other == frame:
        return np.zeros(6)
    first, second = min(frame, other), max(frame, other)
    return _tangent(inverse(world_from_camera[first]) @ world_from_camera[second]) / (second - first)


def _tangent(motion: Array) -> Array:
    """(6,) rotation vector and shift of a motion (4,4)."""
    return np.concatenate([Rotation.from_matrix(motion[:3, :3]).as_rotvec(), motion[:3, 3]])


def _motion(tangent: Array) -> Array:
    return compose(exp_rotation(tangent[:3]), tangent[3:])


def _joined(first: LocalMap, second: LocalMap, moved: Array) -> LocalMap:
    for local_map in (first, second):
        local_map.forget_features()
    whole = stitch(first, second, moved)
    whole.depth_at = first.depth_at
    return whole
