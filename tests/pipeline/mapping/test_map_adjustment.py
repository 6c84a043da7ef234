"""A long map whose scale drifted by a factor: carried along piece by piece, then adjusted as a whole."""

import copy

import numpy as np
import pytest

from haustra.core.ray_table import RayTable
from haustra.core.se3 import in_camera, inverse
from pipeline.mapping import map_adjustment
from pipeline.mapping.local_map import LocalMap, TrackedFrame
from pipeline.mapping.map_adjustment import adjust_all
from pipeline.optimization.bundle_adjustment import reprojections
from reconstruction.evaluation.trajectory_metrics import trajectory_errors
from tests.helpers.camera_geometry import PINHOLE, camera_from_world_at, on_plane

RAYS = RayTable(PINHOLE)
STEP, COUNT = 1.5, 130
TIMES = 70  # that a film of 2,000 keyframes is carried on


def film(rng, noise_px):
    """A map along a tube as it truly is: each keyframe sees the wall from half a radius to two radii ahead."""
    centres = np.stack([[*rng.normal(0, 0.5, 2), STEP * k] for k in range(COUNT)])
    poses = [camera_from_world_at(rng.normal(0, 2, 3), centre) for centre in centres]
    angle, height = rng.uniform(0, 2 * np.pi, 25 * COUNT), rng.uniform(0, STEP * COUNT + 40, 25 * COUNT)
    wall = np.stack([20 * np.cos(angle), 20 * np.sin(angle), height], axis=1)
    made = LocalMap(RAYS)
    made.tracks.reserve(len(wall))
    made.tracks.points[: len(wall)] = wall
    for number, camera_from_world in enumerate(poses):
        plane, depth = on_plane(camera_from_world, wall)
        pixels = 160 + 160 * plane
        ids = np.flatnonzero((depth > 10) & (depth < 45) & ((pixels > 1) & (pixels < 319)).all(axis=1))
        made.add_keyframe(number, camera_from_world, ids, pixels[ids] + rng.normal(0, noise_px, (len(ids), 2)))
    seen = np.bincount(np.concatenate([k.ids for k in made.keyframes]), minlength=len(made.tracks))
    made.tracks.has_point = seen >= 2
    return made


def drifted(true, factor):
    """The map as a tracker would leave it whose unit changed by `factor` on the way, evenly: every point belongs to the
    first keyframe that saw it."""
    made = copy.deepcopy(true)
    unit = factor ** (np.arange(COUNT) / COUNT)
    world = np.stack([inverse(k.camera_from_world) for k in true.keyframes])
    centres = np.cumsum(np.diff(world[:, :3, 3], axis=0, prepend=0) * unit[:, None], axis=0)
    for number in range(COUNT - 1, -1, -1):
        keyframe = made.keyframes[number]
        moved = world[number].copy()
        moved[:3, 3] = centres[number]
        local = unit[number] * in_camera(true.keyframes[number].camera_from_world, true.tracks.points[keyframe.ids])
        keyframe.camera_from_world = inverse(moved)
        made.tracks.points[keyframe.ids] = in_camera(moved, local)
    return made


def error(local_map, true):
    """Path error over the length of the path."""
    found, right = (np.stack([inverse(k.camera_from_world) for k in m.keyframes]) for m in (local_map, true))
    return trajectory_errors(found, right).ate_rmse / (STEP * COUNT)


@pytest.mark.slow
def test_a_scale_that_drifted_thirtyfold_is_taken_back(monkeypatch):
    true = film(np.random.default_rng(0), 0.3)
    for name, value in {"LONG": 60, "PIECE": 30, "FIXED_KEYFRAMES": 15}.items():
        monkeypatch.setattr(map_adjustment, name, value)
    crooked = drifted(true, 30.0)
    assert error(crooked, true) > 0.1
    adjust_all(crooked, changed=True)
    assert error(crooked, true) < 0.002
    assert crooked.tracks.has_point.sum() > 0.95 * true.tracks.has_point.sum(), "hardly a point is lost on the way"


@pytest.mark.parametrize("seen", [pytest.param(0, marks=pytest.mark.slow), 3])
def test_a_blind_keyframe_at_the_end_of_a_piece_does_not_lead(monkeypatch, seen):
    """It says nothing of how the piece moved, or nonsense: the one before does."""
    true = film(np.random.default_rng(3), 0.3)
    for name, value in {"LONG": 60, "PIECE": 30, "FIXED_KEYFRAMES": 15}.items():
        monkeypatch.setattr(map_adjustment, name, value)
    for number in (29, 44, 59):
        keyframe = true.keyframes[number]
        keyframe.keep(np.arange(len(keyframe.ids)) < seen)
    crooked = drifted(true, 3.0)
    adjust_all(crooked, changed=True)
    blind = np.isin(np.arange(COUNT), (29, 44, 59))
    found, right = (np.stack([inverse(k.camera_from_world) for k in m.keyframes])[~blind] for m in (crooked, true))
    assert trajectory_errors(found, right).ate_rmse < 0.002 * STEP * COUNT


def missed(local_map):
    """(M,2) pixels by which all points miss their observations."""
    off = [
        reprojections(in_camera(k.camera_from_world, local_map.tracks.points[k.ids]), k.xy, k.jacobian)
        for k in local_map.keyframes
    ]
    return np.concatenate(off)


@pytest.mark.parametrize("scale", [0.93, *(pytest.param(scale, marks=pytest.mark.slow) for scale in (1.0, 1.1))])
def test_what_is_carried_along_sees_the_same(scale):
    """Again and again, as in a long film: rounding must not grow from one time to the next."""
    true = film(np.random.default_rng(1), 0.0)
    local_map = copy.deepcopy(true)
    turn = camera_from_world_at([0.5, -0.3, 0.2], [0.1, 0.2, -0.1])
    for _ in range(TIMES):
        last = local_map.keyframes[1]
        old, last.camera_from_world = last.camera_from_world, turn @ last.camera_from_world
        local_map.propagate(2, 1, old, scale)
    far = local_map.keyframes[110]
    np.testing.assert_allclose(far.camera_from_world[:3, :3] @ far.camera_from_world[:3, :3].T, np.eye(3), atol=1e-12)
    before, after = (in_camera(m.keyframes[110].camera_from_world, m.tracks.points[far.ids]) for m in (true, local_map))
    assert len(far.ids) > 100
    np.testing.assert_allclose(after, scale**TIMES * before, rtol=1e-7, atol=1e-7 * scale**TIMES)


def test_frames_between_keyframes_are_carried_too():
    true = film(np.random.default_rng(1), 0.0)
    local_map = copy.deepcopy(true)
    for number in (40, 90):  # as if seen half a step after these keyframes
        keyframe = true.keyframes[number]
        relative = camera_from_world_at([0, 0, 0], [0, 0, STEP / 2])
        local_map.tracked_frames.append(TrackedFrame(1000 + number, number, relative, keyframe.ids, keyframe.pixels))
    before = [local_map.camera_from_world_of(posed) for posed in local_map.tracked_frames]
    old = local_map.keyframes[79].camera_from_world
    local_map.keyframes[79].camera_from_world = camera_from_world_at([1, 2, 3], [1, 0, 0]) @ old
    local_map.propagate(80, 79, old, 1.2)
    np.testing.assert_array_equal(local_map.camera_from_world_of(local_map.tracked_frames[0]), before[0])
    ids = np.setdiff1d(true.keyframes[110].ids, np.concatenate([k.ids for k in true.keyframes[:80]]))
    seen = in_camera(local_map.camera_from_world_of(local_map.tracked_frames[1]), local_map.tracks.points[ids])
    np.testing.assert_allclose(seen, 1.2 * in_camera(before[1], true.tracks.points[ids]), atol=1e-9)


def test_carrying_moves_nothing_that_earlier_keyframes_see():
    true = film(np.random.default_rng(2), 0.0)
    local_map = copy.deepcopy(true)
    old = local_map.keyframes[79].camera_from_world
    local_map.keyframes[79].camera_from_world = camera_from_world_at([0, 0, 3], [1, 0, 0]) @ old
    local_map.propagate(80, 79, old, 1.2)
    earlier = np.unique(np.concatenate([k.ids for k in true.keyframes[:80]]))
    np.testing.assert_array_equal(local_map.tracks.points[earlier], true.tracks.points[earlier])
    np.testing.assert_array_equal(
        [k.camera_from_world for k in local_map.keyframes[:79]], [k.camera_from_world for k in true.keyframes[:79]]
    )
    assert np.abs(missed(local_map)).max() > 1, "what both see must be adjusted"
