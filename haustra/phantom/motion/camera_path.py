"""Camera paths: seeded, smooth, with a clearance from the wall and the manoeuvres of a timeline."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from haustra.core.errors import PhantomError
from haustra.phantom.anatomy.colon import Colon
from haustra.phantom.config import MotionConfig
from haustra.phantom.noise import path_noise
from haustra.phantom.raycaster import RayCaster
from haustra.phantom.timeline import Slot

Array = NDArray[np.float64]
PUSH_ROUNDS = 80  # pushes off the wall before a path is given up
TARGETS_MM = (-8.0, -4.0, 0.0, 4.0, 8.0)  # along the centreline; a ray to one alone may graze an edge or end in a polyp
PUSH_SPREAD = 5.0  # frames, standard deviation over which a push off the wall is spread
DIRECTIONS = {"insertion": 1.0, "withdrawal": -1.0, "loop": 1.0}  # sign of the motion in arc length
STANDSTILL = {"pause": 1.0, "look_back": 1.0, "touch": 0.85}  # share of the speed that a manoeuvre removes
SUDDEN = ("quick_turn", "look_back")  # manoeuvres that turn the view
BENDING_MM = 20.0  # radius of the bending section when it is bent hard
MAX_SIDEWAYS = 0.4  # of the tip by bending, in lumen radii
TURNING_POINT = 0.06  # share of the frames over which a loop reverses


def plan_camera_path(
    colon: Colon, caster: RayCaster, motion: MotionConfig, seed: int, timeline: Sequence[Slot] = ()
) -> Array:
    """Poses world_from_camera (N,4,4), mm. The camera looks along increasing arc length, whichever way it moves.

    Raises PhantomError where the path leaves the lumen or does not fit it.
    """
    if motion.direction not in DIRECTIONS:
        raise PhantomError(f"unknown direction {motion.direction!r}; known: {', '.join(DIRECTIONS)}")
    rng = np.random.default_rng([seed, 4])
    going = _going(motion, timeline)
    clock = np.concatenate([[0.0], np.cumsum(going[:-1])])  # stands still while the scope rests
    arc = _progress(colon.line.arc[-1], motion, going, rng)
    centre, frames = colon.line.at(arc)
    sway = motion.wobble_mm * _swings(2, motion, clock, rng)
    positions = centre + frames[..., 0] * sway[:, :1] + frames[..., 1] * sway[:, 1:]
    positions = keep_off(positions, centre, colon, caster, np.full(motion.frames, motion.clearance_mm))
    goal, goal_frames = colon.line.at(arc + motion.ahead_mm)
    looks = np.radians(motion.look_deg) * _swings(2, motion, clock, rng)
    rolls = np.radians(motion.roll_deg) * _swings(1, motion, clock, rng)
    turns = look_at(goal - positions, goal_frames[..., 1]) @ _turns(looks, rolls)
    world_from_camera = np.tile(np.eye(4), (motion.frames, 1, 1))
    world_from_camera[:, :3, :3] = turns @ _sudden_turns(motion, timeline, seed)
    if any(slot.kind in SUDDEN for slot in timeline):
        positions = positions + np.einsum("nij,nj->ni", turns, _bending(colon, motion, timeline, seed))
        positions = keep_off(positions, centre, colon, caster, np.full(motion.frames, motion.clearance_mm))
    world_from_camera[:, :3, 3] = _touch(positions, centre, colon, caster, motion, timeline)
    return world_from_camera


def clearance(colon: Colon, caster: RayCaster, points: Array) -> tuple[Array, Array]:
    """Distance of points (N,3) to the wall (mm, negative outside the lumen) and the unit way off it (N,3).

    The side is determined by rays to the centreline, not by the nearest triangle's normal: at the rim of a sharp fold
    the nearest point lies on an edge, where the triangles' normals do not tell.
    """
    foot, _ = caster.nearest(points)
    away = points - foot
    distance = np.linalg.norm(away, axis=1)
    side = np.where(inside(colon, caster, points), 1.0, -1.0)
    return side * distance, side[:, None] * away / np.maximum(distance, 1e-9)[:, None]


def inside(colon: Colon, caster: RayCaster, points: Array) -> NDArray[np.bool_]:
    """(N,) whether most segments from a point to the centreline nearby cross the wall an even number of times."""
    arc = colon.line.arc[cKDTree(colon.line.points).query(points)[1]]
    targets = colon.line.at(arc[:, None] + np.array(TARGETS_MM))[0]
    origins = np.broadcast_to(points[:, None], targets.shape)
    return (caster.crossings(origins, targets) % 2 == 0).sum(axis=1) > len(TARGETS_MM) / 2


def _going(motion: MotionConfig, timeline: Sequence[Slot]) -> Array:
    """Factor (N,) on the speed by the manoeuvres of each frame."""
    going = np.ones(motion.frames)
    for slot in timeline:
        if slot.kind in STANDSTILL:
            going -= STANDSTILL[slot.kind] * np.array([slot.strength(frame) for frame in range(motion.frames)])
    return np.maximum(going, 0.0)


def _progress(length: float, motion: MotionConfig, going: Array, rng: np.random.Generator) -> Array:
    """Arc length (N,) mm of each frame; a loop reverses and ends where it began."""
    pace = np.maximum(0.1, 1 + motion.speed_variation * path_noise(motion.frames, motion.wobble_period, rng))
    steps = motion.speed_mm * pace * going
    if motion.direction == "loop":
        middle, ease = 0.5 * motion.frames, max(TURNING_POINT * motion.frames, 1.0)
        steps = steps * np.tanh((middle - np.arange(motion.frames)) / ease)
        out, back = np.maximum(steps, 0.0), np.minimum(steps, 0.0)
        steps = out + back * out.sum() / max(-back[:-1].sum(), 1e-9)
    travelled = np.concatenate([[0.0], np.cumsum(steps[:-1])])
    arc = motion.start * length + DIRECTIONS[motion.direction] * travelled
    if arc.min() < 0 or arc.max() > length:
        far = np.abs(travelled).max()
        raise PhantomError(f"a path of {far:.0f} mm from {motion.start:.0%} leaves the {length:.0f} mm lumen")
    return arc


def _swings(count: int, motion: MotionConfig, clock: Array, rng: np.random.Generator) -> Array:
    """Independent smooth signals (N,count) within about [-1, 1], read at the clock's times (N,) in frames."""
    ticks = np.arange(motion.frames)
    swings = [np.interp(clock, ticks, path_noise(motion.frames, motion.wobble_period, rng)) for _ in range(count)]
    return np.stack(swings, axis=1)


def keep_off(positions: Array, centre: Array, colon: Colon, caster: RayCaster, wanted_mm: Array) -> Array:
    """Push positions (N,3) off the wall, each push spread over neighbouring frames, until all are clear."""
    for _ in range(PUSH_ROUNDS):
        distance, away = clearance(colon, caster, positions)
        if (distance >= wanted_mm).all():
            return positions
        outside = distance < 0  # outside the lumen the nearest way off the wall may lead outwards: push to the centre
        home = (centre - positions) / np.maximum(np.linalg.norm(centre - positions, axis=1), 1e-9)[:, None]
        push = np.maximum(wanted_mm + 0.3 - distance, 0.0)[:, None] * np.where(outside[:, None], home, away)
        positions = positions + 1.5 * gaussian_filter1d(push, PUSH_SPREAD, axis=0, mode="nearest")
    raise PhantomError(
        f"no path with {wanted_mm.max():g} mm clearance: the lumen is too narrow, or the clearance too wide"
    )


def _touch(
    positions: Array, centre: Array, colon: Colon, caster: RayCaster, motion: MotionConfig, timeline: Sequence[Slot]
) -> Array:
    """Lead the tip towards the nearest wall and back, once per "touch" slot, to about `touch_mm` from it.

    Other wall nearby may push the tip off again: gaps of up to twice `touch_mm` occur, below half of it never.
    """
    for slot in (slot for slot in timeline if slot.kind == "touch"):
        strength = np.array([slot.strength(tick) for tick in range(motion.frames)])
        middle = (slot.first + slot.last) // 2
        distance, away = clearance(colon, caster, positions[middle : middle + 1])
        closer = positions - strength[:, None] * away * (distance - motion.touch_mm)
        # Elsewhere along the way a fold may be nearer than the wall that is aimed at: keep the path's own distance.
        own = clearance(colon, caster, positions)[0]
        wanted = np.minimum(own - 0.3, motion.clearance_mm) * (1 - strength) + 0.6 * motion.touch_mm * strength
        positions = keep_off(closer, centre, colon, caster, np.minimum(wanted, own))
    return positions


def _sudden_turns(motion: MotionConfig, timeline: Sequence[Slot], seed: int) -> Array:
    """Rotations (N,3,3) in camera axes: quick swings of the view, and bending round to look back."""
    total = Rotation.identity(motion.frames)
    for slot in (slot for slot in timeline if slot.kind in SUDDEN):
        heading, angle = _turn_of(slot, motion, seed)
        axis = np.array([np.cos(heading), np.sin(heading), 0.0])
        total = total * Rotation.from_rotvec(angle[:, None] * axis)
    return total.as_matrix()


def _bending(colon: Colon, motion: MotionConfig, timeline: Sequence[Slot], seed: int) -> Array:
    """Sideways shift (N,3) mm of the tip in camera axes, by the bending section that turns it.

    An arc of radius r bent by an angle shifts its end sideways by r (1 - cos angle), at most MAX_SIDEWAYS radii.
    """
    way = np.zeros((motion.frames, 3))
    for slot in (slot for slot in timeline if slot.kind in SUDDEN):
        heading, angle = _turn_of(slot, motion, seed)
        sideways = np.minimum(BENDING_MM * (1 - np.cos(angle)), MAX_SIDEWAYS * colon.anatomy.radius_mm)
        way += sideways[:, None] * np.array([np.sin(heading), -np.cos(heading), 0.0])  # where the view turns to
    return way


def _turn_of(slot: Slot, motion: MotionConfig, seed: int) -> tuple[float, Array]:
    """Direction of the axis in the image plane, and the angle (N,) about it, both rad."""
    heading = float(np.random.default_rng([seed, 8, slot.number + 1]).uniform(0, 2 * np.pi))
    most = {"quick_turn": motion.quick_turn_deg, "look_back": motion.look_back_deg}[slot.kind]
    return heading, np.radians(most) * np.array([slot.strength(tick) for tick in range(motion.frames)])


def look_at(forward: Array, down: Array) -> Array:
    """Rotations (N,3,3), columns right, down, forward, from a view direction and a rough down direction."""
    z = forward / np.linalg.norm(forward, axis=1, keepdims=True)
    x = np.cross(down, z)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def _turns(looks: Array, rolls: Array) -> Array:
    """Look-around (N,2) and roll (N,1) in radians as rotations (N,3,3) applied in camera axes."""
    pan_tilt = Rotation.from_rotvec(np.concatenate([looks, np.zeros_like(rolls)], axis=1))
    roll = Rotation.from_rotvec(np.concatenate([np.zeros_like(looks), rolls], axis=1))
    return (pan_tilt * roll).as_matrix()
