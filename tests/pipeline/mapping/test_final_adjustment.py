"""A finished map adjusted to the features of its keyframes, on rendered views of a textured tube."""

import copy
from dataclasses import replace

import cv2
import numpy as np
import pytest

from haustra.core.se3 import in_camera, inverse
from haustra.core.sim3 import umeyama
from pipeline.mapping import final_adjustment
from pipeline.mapping.final_adjustment import adjust_to_features
from pipeline.mapping.local_map import TrackKind
from pipeline.mapping.submap_of_map import to_submap
from pipeline.matching import sift_cache
from pipeline.matching.sift_cache import SiftCache
from reconstruction.evaluation.trajectory_metrics import trajectory_errors
from tests.helpers.tubes.textured_tube import CAMERA, MASK, RADIUS, camera_at, polished, render, run

TRUE = np.stack([camera_at(k) for k in range(40)])
IMAGES = [render(world_from_camera) for world_from_camera in TRUE]


def read(frame):
    return IMAGES[frame], MASK


def make():
    maps, _ = run(IMAGES)
    return polished(maps)[0]


@pytest.fixture(scope="module")
def finished():
    return make()


@pytest.fixture(scope="module")
def features():
    """The features of the film as it is, found once: they are the same whatever map asks."""
    return SiftCache(read)


@pytest.fixture(scope="module")
def adjusted(finished, features):
    """The finished map, adjusted to its features; not to be changed."""
    local_map = copy.deepcopy(finished)
    assert adjust_to_features(local_map, features)
    return local_map


@pytest.fixture(scope="module")
def straightened(finished, features):
    """A bent map, adjusted to its features, and its error before; not to be changed."""
    local_map = bent(finished, 0.25)
    before = error(local_map)
    assert adjust_to_features(local_map, features)
    return local_map, before


def bent(local_map, growth):
    """The map with a scale that grows along the axis: as corners that slide would leave it."""
    world = to_submap(local_map, CAMERA.params)
    direction = world.centres[-1] - world.centres[0]
    length = float(np.linalg.norm(direction))
    start = world.centres[0].copy()

    def place(points):
        along = ((points - start) @ direction / length**2).clip(-1, 2)[..., None]
        return start + (points - start) * np.exp(growth * along)

    result = copy.deepcopy(local_map)
    for keyframe in result.keyframes:
        outward = inverse(keyframe.camera_from_world)
        outward[:3, 3] = place(outward[None, :3, 3])[0]
        keyframe.camera_from_world = inverse(outward)
    result.tracks.points = place(result.tracks.points)
    return result


def frames_of(local_map):
    return [keyframe.frame for keyframe in local_map.keyframes]


def poses_of(local_map):
    return np.stack([inverse(keyframe.camera_from_world) for keyframe in local_map.keyframes])


def features_seen(local_map):
    """Of each keyframe, how many features that the map was adjusted to."""
    features = local_map.tracks.is_kind(TrackKind.FEATURE)
    return [int(features[keyframe.ids].sum()) for keyframe in local_map.keyframes]


def error(local_map):
    submap = to_submap(local_map, CAMERA.params)
    return trajectory_errors(submap.world_from_camera, TRUE[submap.frames]).ate_rmse


def test_a_bent_scale_is_taken_back(straightened):
    crooked, before = straightened
    assert before > 0.4
    assert error(crooked) < 0.05 * before


def test_features_and_followed_corners_are_told_apart(finished, adjusted):
    assert to_submap(finished, CAMERA.params).is_klt.all()
    local_map = adjusted
    submap = to_submap(local_map, CAMERA.params)
    assert not to_submap(local_map, CAMERA.params, kind=TrackKind.FEATURE).is_klt.any()
    between = ~np.isin(submap.frames, [keyframe.frame for keyframe in local_map.keyframes])
    seen_between = np.unique(submap.observations[between[submap.observations[:, 0]], 1])
    assert submap.is_klt[seen_between].all(), "features are looked for in keyframes alone"
    assert 100 < submap.is_klt.sum() < len(submap.points) - 100


def test_the_features_lie_on_the_wall(adjusted):
    submap = to_submap(adjusted, CAMERA.params, kind=TrackKind.FEATURE)
    aligned = umeyama(submap.centres, TRUE[submap.frames, :3, 3], with_scale=True)
    points = submap.points @ aligned[:3, :3].T + aligned[:3, 3]
    off = np.abs(np.linalg.norm(points[:, :2], axis=1) - RADIUS)
    assert len(points) > 300
    assert np.median(off) < 0.01 * RADIUS


def test_wall_beyond_the_followed_corners_gets_points_too(finished, features):
    """Near wall at the picture's edge, where no corner was followed: its features lie on the wall."""
    local_map = copy.deepcopy(finished)
    half = min(MASK.shape) / 2
    for keyframe in local_map.keyframes:
        keyframe.keep(np.linalg.norm(keyframe.pixels - np.array(MASK.shape[::-1]) / 2, axis=1) < 0.7 * half)
    assert adjust_to_features(local_map, features)
    # Guesses are too deep out there; frames between keyframes must not grow by them: 0.02 off, by them 0.07.
    frames = np.array(frames_of(local_map) + [posed.frame for posed in local_map.tracked_frames])
    between = np.stack([inverse(local_map.camera_from_world_of(posed)) for posed in local_map.tracked_frames])
    assert trajectory_errors(np.concatenate([poses_of(local_map), between]), TRUE[frames]).ate_rmse < 0.035
    submap = to_submap(local_map, CAMERA.params, kind=TrackKind.FEATURE)
    point = submap.observations[:, 1]
    out = np.linalg.norm(submap.pixels - np.array(MASK.shape[::-1]) / 2, axis=1) > 0.85 * half
    assert out.sum() > 5 * len(local_map.keyframes)
    aligned = umeyama(submap.centres, TRUE[submap.frames, :3, 3], with_scale=True)
    points = submap.points[np.unique(point[out])] @ aligned[:3, :3].T + aligned[:3, 3]
    assert np.median(np.abs(np.linalg.norm(points[:, :2], axis=1) - RADIUS)) < 0.01 * RADIUS


def sliding(found, wider_than):
    """The features, the wide ones 1.5 px farther from the picture's centre: as if the wall there were nearer."""
    outward = found.pixels - np.array(MASK.shape[::-1]) / 2
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    return replace(found, pixels=found.pixels + 1.5 * outward * (found.sizes > wider_than)[:, None])


def test_wide_features_follow_and_do_not_move_the_map(finished, monkeypatch):
    """Where every wide feature is off, the map is right if they follow, and wrong if they take part."""
    limit = 5.0
    found = sift_cache.detect_sift
    monkeypatch.setattr(sift_cache, "detect_sift", lambda *a: sliding(found(*a), limit))
    monkeypatch.setattr(final_adjustment, "WIDEST", limit)
    following, moving = copy.deepcopy(finished), copy.deepcopy(finished)
    asked, adjust = [], final_adjustment.adjust_all
    monkeypatch.setattr(final_adjustment, "adjust_all", lambda *a: asked.append(a[3]) or adjust(*a))
    assert adjust_to_features(following, SiftCache(read))
    (took_part,) = asked
    assert took_part.sum() > 100
    assert (following.tracks.kind[took_part] == TrackKind.FEATURE).all(), "neither wide features nor corners"
    wide = following.tracks.is_kind(TrackKind.WIDE_FEATURE)
    assert following.tracks.has_point[wide].sum() > 50, "wide features have points"
    monkeypatch.setattr(final_adjustment, "WIDEST", np.inf)
    assert adjust_to_features(moving, SiftCache(read))
    off = [trajectory_errors(poses_of(m), TRUE[frames_of(m)]).ate_rmse for m in (following, moving)]
    assert off[0] < 0.6 * off[1]


def test_where_narrow_features_are_too_few_the_wide_ones_help(finished):
    blurred = [cv2.GaussianBlur(image, (0, 0), 3.3) for image in IMAGES]
    local_map = bent(finished, 0.25)
    before = error(local_map)
    assert adjust_to_features(local_map, SiftCache(lambda frame: (blurred[frame], MASK)))
    assert error(local_map) < 0.3 * before


def test_too_few_features_move_nothing(finished):
    local_map = copy.deepcopy(finished)
    poses = [keyframe.camera_from_world.copy() for keyframe in local_map.keyframes]
    points = local_map.tracks.points.copy()
    assert not adjust_to_features(
        local_map, SiftCache(lambda frame: (cv2.GaussianBlur(IMAGES[frame], (0, 0), 6), MASK))
    )
    np.testing.assert_array_equal(local_map.tracks.points, points)
    np.testing.assert_array_equal([keyframe.camera_from_world for keyframe in local_map.keyframes], poses)


def test_a_keyframe_without_features_follows_its_neighbour(finished):
    blind = len(finished.keyframes) // 2
    frame = finished.keyframes[blind].frame
    local_map = bent(finished, 0.25)
    for keyframe in local_map.keyframes[blind : blind + 1]:
        keyframe.keep(np.zeros(len(keyframe.ids), bool))
    hidden = np.zeros_like(MASK)
    assert adjust_to_features(
        local_map, SiftCache(lambda number: (IMAGES[number], hidden if number == frame else MASK))
    )
    poses = np.stack([inverse(keyframe.camera_from_world) for keyframe in local_map.keyframes])
    true = TRUE[[keyframe.frame for keyframe in local_map.keyframes]]
    aligned = umeyama(poses[:, :3, 3], true[:, :3, 3], with_scale=True)
    off = np.linalg.norm(poses[:, :3, 3] @ aligned[:3, :3].T + aligned[:3, 3] - true[:, :3, 3], axis=1)
    step = np.linalg.norm(true[blind, :3, 3] - true[blind - 1, :3, 3])
    assert off[blind] < 0.2 * step
    assert np.median(off) < 0.05 * step


def other_wall(frames):
    """Features of the film, but that those of `frames` are described as nothing that the other frames show."""
    found = SiftCache(read)

    def of(frame):
        features = found(frame)
        return replace(features, descriptors=features.descriptors[:, ::-1]) if frame in frames else features

    return of


def test_a_few_keyframes_that_hang_together_alone_follow_the_others(finished, adjusted):
    """The first ones, bent away: their features match each other's, and none of the rest of the map's."""
    local_map = copy.deepcopy(finished)
    count = len(local_map.keyframes)
    alone = max(2, int(final_adjustment.MAX_FOLLOWING * count))
    for keyframe in local_map.keyframes[:alone]:
        keyframe.camera_from_world = keyframe.camera_from_world.copy()
        keyframe.camera_from_world[:3, 3] += 0.2
    before = poses_of(local_map)
    assert adjust_to_features(local_map, other_wall(set(frames_of(local_map)[:alone])))
    after, right = poses_of(local_map), poses_of(adjusted)
    np.testing.assert_allclose(after[alone + 1 :, :3, 3], right[alone + 1 :, :3, 3], atol=0.05)
    was, now = inverse(before[alone]) @ before[0], inverse(after[alone]) @ after[0]
    np.testing.assert_allclose(now[:3, :3], was[:3, :3], atol=1e-6)
    length = np.linalg.norm(was[:3, 3])
    np.testing.assert_allclose(now[:3, 3] / np.linalg.norm(now[:3, 3]), was[:3, 3] / length, atol=1e-6)
    assert np.linalg.norm(now[:3, 3]) == pytest.approx(length, rel=0.05), "it grows as its neighbour's surroundings did"
    features = local_map.tracks.is_kind(TrackKind.FEATURE) & local_map.tracks.has_point
    assert not any(features[keyframe.ids].any() for keyframe in local_map.keyframes[:alone])


def test_a_few_that_hang_together_alone_are_too_many_in_a_map_that_was_joined(finished):
    """There they are the other map, and the join is wrong."""
    local_map = copy.deepcopy(finished)
    before = poses_of(local_map)
    alone = set(frames_of(local_map)[: max(2, int(final_adjustment.MAX_FOLLOWING * len(before)))])
    assert adjust_to_features(local_map, other_wall(alone), allow_disconnected=False) is None
    np.testing.assert_array_equal(poses_of(local_map), before)


def test_halves_that_hang_together_alone_move_nothing(finished):
    local_map = copy.deepcopy(finished)
    before = poses_of(local_map)
    assert adjust_to_features(local_map, other_wall(set(frames_of(local_map)[: len(local_map.keyframes) // 2]))) is None
    np.testing.assert_array_equal(poses_of(local_map), before)


def test_a_second_time_the_features_of_the_first_are_forgotten(adjusted, features):
    local_map = copy.deepcopy(adjusted)
    seen = features_seen(local_map)
    assert adjust_to_features(local_map, features)
    assert np.median(features_seen(local_map)) == pytest.approx(np.median(seen), rel=0.1)
    local_map.forget_features()
    assert not any(features_seen(local_map))


def test_two_runs_agree_to_the_bit(finished, adjusted):
    first, second = adjusted, copy.deepcopy(finished)
    assert adjust_to_features(second, SiftCache(read)), "with features that are found anew"
    np.testing.assert_array_equal(first.tracks.points, second.tracks.points)
    for one, other in zip(first.keyframes, second.keyframes, strict=True):
        np.testing.assert_array_equal(one.camera_from_world, other.camera_from_world)
        np.testing.assert_array_equal(one.ids, other.ids)


def test_points_of_the_followed_corners_fit_the_moved_keyframes(straightened):
    local_map, _ = straightened
    corners = local_map.tracks.is_kind(TrackKind.KLT)
    for keyframe in local_map.keyframes:
        mine = local_map.tracks.has_point[keyframe.ids] & corners[keyframe.ids]
        local = in_camera(keyframe.camera_from_world, local_map.tracks.points[keyframe.ids[mine]])
        off = np.linalg.norm(CAMERA.project(local) - keyframe.pixels[mine], axis=1)
        assert np.median(off) < 0.5
        assert off.max() < 2.01


def test_text_burned_into_the_picture_does_not_bend_the_map(finished):
    """Letters stand still where the wall should move; without them the map must come out as right."""
    letters = np.zeros_like(IMAGES[0])
    for row in range(4):
        cv2.putText(letters, "ABC 123", (8, 24 + 14 * row), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255, 255, 255), 1)
    local_map = copy.deepcopy(finished)
    assert adjust_to_features(local_map, SiftCache(lambda frame: (np.maximum(IMAGES[frame], letters), MASK)))
    assert error(local_map) < error(finished)
