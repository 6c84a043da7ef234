"""Maps joined over a stretch that shows nothing, by what a sensor measured in it.

A burnt, blurred or covered second ends a map, and the next begins in a world of its own. Where both are in millimetres,
the sensor's clouds are followed from one to the other, in both directions (`depth_odometry`), and the clouds of both
sides are registered to each other (`cloud_registration`).
"""

from dataclasses import dataclass

import numpy as np

from haustra.core.progress import Progress
from haustra.core.se3 import Array, in_camera, inverse, share_of, tangent_of
from pipeline.frontend.odometry.bridging.cloud_registration import WallPatches
from pipeline.frontend.odometry.bridging.depth_clouds import STEP, Clouds, joint_cloud
from pipeline.frontend.odometry.bridging.depth_odometry import PACE, followed
from pipeline.frontend.odometry.chunk_stitching import frame_observations, stitch
from pipeline.mapping.final_adjustment import adjust_to_features
from pipeline.mapping.local_map import LocalMap
from pipeline.matching.sift import FindFeatures

MOST_FRAMES = 60  # of a gap: two seconds
# Chosen on gaps of films of coverage_films.yaml (docs/lab/blind_stretch.md), the way back on earlier ones.
MOST_WORSE = 1.6  # times as far from the wall as a cloud of either side lies from its own, and it does not belong there
LEAST_WORSE_MM = 0.3  # of a median distance, below which it says nothing
LEAST_SHARE = 0.3  # of the first cloud after the gap that lies where wall was seen before it
MOST_BACK = np.radians(6.0), 2.5  # turn and shift, mm, between a registration and the one back
MOST_APART = np.radians(6.0), 3.0  # between registrations from two ways
MOST_OFF_WAY = np.radians(8.0), 4.0  # between a registration and depth odometry over the gap


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
        between = min(local_map.frames) - max(before.frames) - 1
        whole = _joined(before.copied(), local_map.copied(), moved)
        width = adjust_to_features(whole, find, allow_disconnected=False)
        first, doubt = min(local_map.frames), "" if width is not None else "; too few features agree to adjust it"
        progress.log(f"submap from frame {first} on joined to the one before over {between} frames by depth{doubt}")
        result[-1], count = whole, count + 1
    return result, count


def first_from_second(first: LocalMap, second: LocalMap, clouds: Clouds) -> Array | None:
    """The second world in the first (4,4), both mm; None where the gap is long, or the clouds do not fit."""
    if first.depth_at is None or second.depth_at is None:
        return None
    here, there = (poses_of(local_map) for local_map in (first, second))
    world_from_camera = registered_over_gap(here, there, clouds)
    return None if world_from_camera is None else np.asarray(world_from_camera @ inverse(there[min(there)]))


@dataclass(frozen=True)
class Registered:
    """A pose, world_from_camera (4,4), at which two sides' clouds fit, and how badly they do."""

    pose: Array
    misfit: float


def registered_over_gap(here: dict[int, Array], there: dict[int, Array], clouds: Clouds) -> Array | None:
    """world_from_camera (4,4) of the first frame of `there` in the world of `here`, poses by frame; None where the gap
    is long, the clouds of both sides overlap too little, or what speaks for a pose does not agree.

    Depth odometry over the gap, once from either side, gives two poses that share no wall. The clouds of both sides are
    registered from each. A pose is taken at which both registrations end and to which one way has led, or at which one
    ends and to which the other way has led.
    """
    end, begin = max(here), min(there)
    if not 0 < begin - end <= MOST_FRAMES or min(len(here), len(there)) <= PACE:
        return None
    sides = _Sides.of(here, there, clouds)
    forwards, backwards = followed(here, end, begin, clouds), followed(there, begin, end, clouds)
    if sides is None or forwards is None or backwards is None:
        return None
    ways = forwards, np.asarray(here[end] @ inverse(backwards) @ there[begin])
    wall = WallPatches.of(in_camera(here[end], sides.before))
    found = [sides.checked(wall, here[end], wall.registered(sides.after, way)) for way in ways]
    return _agreed(ways, found)


def _agreed(ways: tuple[Array, Array], found: list[Registered | None]) -> Array | None:
    """Of registrations from two ways, or the one that passed: the pose that the evidence agrees on, if it does."""
    one, other = found
    if one is not None and other is not None:
        best = min(one, other, key=lambda registered: registered.misfit)
        near = any(_is_near(best.pose, way, MOST_OFF_WAY) for way in ways)
        return best.pose if near and _is_near(one.pose, other.pose, MOST_APART) else None
    for registered, way in ((one, ways[1]), (other, ways[0])):  # the way that it did not start from
        if registered is not None and _is_near(registered.pose, way, MOST_OFF_WAY):
            return registered.pose
    return None


def _is_near(pose: Array, other: Array, most: tuple[float, float]) -> bool:
    """Whether two poses are within a turn (radians) and a shift (mm)."""
    apart = tangent_of(inverse(pose) @ other)
    return bool(np.linalg.norm(apart[:3]) <= most[0] and np.linalg.norm(apart[3:]) <= most[1])


@dataclass(frozen=True)
class _Sides:
    """Clouds on both sides of a gap, each in the axes of its frame next to the gap, mm: of the frames before (N,3), of
    those after (M,3), as patches too, and of the first one after (K,3); usual: how far, mm, such a one lies from those
    beside it."""

    before: Array
    after: Array
    after_patches: WallPatches
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
        after = np.concatenate([first, after])
        return _Sides(np.concatenate([before, last]), after, WallPatches.of(after), first, max(off))

    def checked(self, wall: WallPatches, last_pose: Array, found: Array | None) -> Registered | None:
        """The middle of `found`, world_from_camera (4,4) of the first frame after the gap, and of that frame by the
        registration back; None where one fails or the two differ, where either wall leaves a direction free, or where
        the frame's cloud does not lie on the wall from before the gap."""
        back = None if found is None else self.after_patches.registered(self.before, inverse(found) @ last_pose)
        if found is None or back is None:
            return None
        by_back = np.asarray(last_pose @ inverse(back))
        if not _is_near(found, by_back, MOST_BACK):
            return None
        if not (wall.holds(self.after, found) and self.after_patches.holds(self.before, back)):
            return None
        off, share = wall.fit(self.first, found)
        if off > max(LEAST_WORSE_MM, MOST_WORSE * self.usual) or share < LEAST_SHARE:
            return None
        pose = np.asarray(found @ share_of(inverse(found) @ by_back, 0.5))
        return Registered(pose, wall.misfit(self.after, pose))


def poses_of(local_map: LocalMap) -> dict[int, Array]:
    """world_from_camera (4,4) by frame."""
    return {frame: inverse(seen.camera_from_world) for frame, seen in frame_observations(local_map).items()}


def _joined(first: LocalMap, second: LocalMap, moved: Array) -> LocalMap:
    for local_map in (first, second):
        local_map.forget_features()
    whole = stitch(first, second, moved)
    whole.depth_at = first.depth_at
    return whole
