"""Manoeuvres and their timetable: what the scope does, measured on the poses alone."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haustra.core.errors import PhantomError
from haustra.phantom.anatomy.colon import build_colon
from haustra.phantom.config import EventsConfig, MotionConfig
from haustra.phantom.dataset.scenes import SCENES, film_of, scene_config
from haustra.phantom.imaging.render import Phantom
from haustra.phantom.motion.camera_path import clearance, inside, plan_camera_path
from haustra.phantom.raycaster import RayCaster
from haustra.phantom.timeline import plan_timeline
from tests.helpers.tiny_phantom import TINY

BASE = replace(TINY.motion, frames=120, start=0.45, speed_mm=0.2, wobble_period=40.0)


@pytest.fixture(scope="module")
def phantom() -> Phantom:
    return Phantom(TINY, threads=1)


def filmed(phantom: Phantom, motion: MotionConfig, seed: int = 1) -> tuple[np.ndarray, dict[str, slice]]:
    """The path, and the frames of each manoeuvre at full strength."""
    timeline = plan_timeline(motion, EventsConfig(), seed)
    poses = plan_camera_path(phantom.colon, phantom.caster, motion, seed, timeline)
    full = {slot.kind: [f for f in range(motion.frames) if slot.strength(f) == 1] for slot in timeline}
    return poses, {kind: slice(frames[0], frames[-1] + 1) for kind, frames in full.items()}


def steps_mm(poses: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)


@given(
    counts=st.lists(st.integers(0, 2), min_size=9, max_size=9),
    frames=st.integers(30, 900),
    seed=st.integers(0, 2**31 - 1),
)
@settings(max_examples=60, deadline=None)
def test_slots_are_all_there_in_order_and_apart(counts: list[int], frames: int, seed: int) -> None:
    motion = MotionConfig(
        frames=frames, pauses=counts[0], touches=counts[1], quick_turns=counts[2], look_backs=counts[3]
    )
    events = EventsConfig(*counts[4:])
    lengths = motion.fps * (sum(counts) + 2 * counts[3]) * 1.25
    if lengths > frames:
        with pytest.raises(PhantomError, match="the film has"):
            plan_timeline(motion, events, seed)
        return
    slots = plan_timeline(motion, events, seed)
    assert len(slots) == sum(counts)
    assert all(0 <= slot.first < slot.last < frames for slot in slots)
    assert all(one.last < other.first for one, other in pairwise(slots))
    assert slots == plan_timeline(motion, events, seed)
    assert all(slot.strength(slot.first) == 0 and slot.strength((slot.first + slot.last) / 2) == 1 for slot in slots)


def test_without_manoeuvres_the_timetable_is_empty_and_the_path_as_ever(phantom: Phantom) -> None:
    assert plan_timeline(BASE, EventsConfig(), 1) == []
    poses, _ = filmed(phantom, BASE)
    assert steps_mm(poses).min() > 0


def test_a_pause_rests(phantom: Phantom) -> None:
    poses, slots = filmed(phantom, replace(BASE, pauses=1))
    resting = poses[slots["pause"]]
    np.testing.assert_allclose(resting, np.tile(resting[0], (len(resting), 1, 1)), atol=0.02)
    assert np.delete(steps_mm(poses), range(slots["pause"].start - 12, slots["pause"].stop + 12)).min() > 0.01


def test_a_touch_leaves_the_stated_gap(phantom: Phantom) -> None:
    motion = replace(BASE, touches=1, touch_mm=0.9)
    poses, slots = filmed(phantom, motion)
    gap, _ = clearance(phantom.colon, phantom.caster, poses[:, :3, 3])
    middle = (slots["touch"].start + slots["touch"].stop) // 2
    assert gap[middle] == pytest.approx(0.9, abs=0.5)
    assert gap.min() > 0.5 * motion.touch_mm  # never through the wall
    assert gap[0] >= motion.clearance_mm


@pytest.mark.parametrize(("kind", "field"), [("quick_turn", "quick_turns"), ("look_back", "look_backs")])
def test_turns_reach_their_angle_and_come_back(phantom: Phantom, kind: str, field: str) -> None:
    motion = replace(BASE, **{field: 1}, look_deg=0.0, roll_deg=0.0, wobble_mm=0.0)
    poses, slots = filmed(phantom, motion)
    still, _ = filmed(phantom, replace(BASE, look_deg=0.0, roll_deg=0.0, wobble_mm=0.0))
    forward = phantom.colon.line.at(np.array(50.0))[1][:, 2]
    angle = np.degrees(np.arccos(np.clip(poses[:, :3, 2] @ forward, -1, 1)))
    usual = np.degrees(np.arccos(np.clip(still[:, :3, 2] @ forward, -1, 1))).max()
    wanted = {"quick_turn": motion.quick_turn_deg, "look_back": motion.look_back_deg}[kind]
    assert angle[slots[kind]].max() == pytest.approx(wanted, abs=usual)
    assert max(angle[0], angle[-1]) <= usual + 1e-6


def winding(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Solid angle of all triangles (F,3,3) over 4 pi, seen from each point (van Oosterom & Strackee 1983)."""
    a, b, c = (corners[None, :, i] - points[:, None] for i in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    above = np.einsum("pfi,pfi->pf", a, np.cross(b, c))
    below = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    return np.abs(np.arctan2(above, below).sum(axis=1) / (2 * np.pi))


@pytest.mark.parametrize("seed", range(3))
def test_which_side_of_the_wall_agrees_with_the_winding_number(seed: int) -> None:
    """Sharp, leaning folds: the nearest point is often on a rim, where a triangle's normal tells nothing."""
    anatomy = replace(
        TINY.anatomy,
        fold_depth_mm=6.0,
        fold_width_mm=1.5,
        fold_edge_mm=0.3,
        fold_lean=0.5,
        pedunculated=1,
        diverticula=1,
    )
    colon = build_colon(anatomy, seed)
    caster = RayCaster(colon.vertices, colon.triangles, 1)
    rng = np.random.default_rng(seed)
    arc = rng.uniform(30, 80, 100)
    centre, frames = colon.line.at(arc)
    out = rng.uniform(0, 1.3 * anatomy.radius_mm, 100)
    around = rng.uniform(0, 2 * np.pi, 100)
    points = centre + out[:, None] * (
        np.cos(around)[:, None] * frames[..., 0] + np.sin(around)[:, None] * frames[..., 1]
    )
    turns = winding(points, colon.vertices[colon.triangles].astype(float))
    sure = np.abs(turns - 0.5) > 0.1  # open ends take a little from inside
    assert sure.mean() > 0.95
    np.testing.assert_array_equal(inside(colon, caster, points)[sure], turns[sure] > 0.5)


def test_the_tip_moves_sideways_when_it_bends_round(phantom: Phantom) -> None:
    """In the direction that the view turns to; a camera that turned on the spot would show no parallax."""
    motion = replace(BASE, look_backs=1, look_deg=0.0, roll_deg=0.0, wobble_mm=0.0, speed_mm=0.0)
    poses, slots = filmed(phantom, motion)
    way = poses[slots["look_back"].start, :3, 3] - poses[0, :3, 3]
    turned = poses[slots["look_back"].start, :3, 2]
    across = turned - (turned @ poses[0, :3, 2]) * poses[0, :3, 2]
    assert 0.2 * TINY.anatomy.radius_mm < np.linalg.norm(way) < 0.5 * TINY.anatomy.radius_mm
    assert way @ across / np.linalg.norm(way) / np.linalg.norm(across) > 0.8
    np.testing.assert_allclose(poses[-1], poses[0], atol=1e-6)


def test_a_loop_ends_where_it_began_by_another_way(phantom: Phantom) -> None:
    motion = replace(BASE, direction="loop", start=0.35, speed_mm=0.5, wobble_mm=2.0)
    poses, _ = filmed(phantom, motion)
    tangent = phantom.colon.line.at(np.array(0.35 * 110.0))[1][:, 2]
    along = (poses[:, :3, 3] - poses[0, :3, 3]) @ tangent
    assert abs(along[-1]) < 1.5
    assert along.max() > 15
    assert 0.4 < along.argmax() / len(along) < 0.6
    out, back = poses[30, :3, 3], poses[:, :3, 3][60:]
    assert np.linalg.norm(back - out, axis=1).min() > 0.2


def test_long_films_get_a_longer_gut() -> None:
    for scene in SCENES:
        config = film_of(scene_config(scene, 3), frames=300, size=64)
        assert config.motion.frames == 300
        travelled = config.motion.speed_mm * 300 * (1 + config.motion.speed_variation)
        assert travelled <= 0.5 * config.anatomy.length_mm + 1e-6
    endless = film_of(scene_config("colon"), frames=100_000)
    assert endless.anatomy.length_mm == 1200
    assert endless.motion.speed_mm < scene_config("colon").motion.speed_mm


def test_what_cannot_be_filmed_is_refused_in_a_sentence(phantom: Phantom) -> None:
    with pytest.raises(PhantomError, match="unknown direction"):
        filmed(phantom, replace(BASE, direction="sideways"))
    with pytest.raises(PhantomError, match="leaves the 110 mm lumen"):
        filmed(phantom, replace(BASE, speed_mm=5.0))
    with pytest.raises(PhantomError, match="unknown scene"):
        scene_config("stomach")
