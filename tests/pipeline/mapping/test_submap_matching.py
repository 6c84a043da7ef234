"""The streaming front end's gates, one by one: what may be tracked, what is adjusted, what joins two maps."""

from dataclasses import replace

import numpy as np
import pytest

from haustra.core.camera import Camera
from haustra.core.ray_table import RayTable
from haustra.core.se3 import in_camera, inverse
from pipeline.frontend.odometry.klt import normalise
from pipeline.frontend.odometry.tracking import Odometry, Tracker
from pipeline.mapping import submap_matching, submap_merging
from pipeline.mapping.local_map import Keyframe, LocalMap
from pipeline.mapping.map_adjustment import adjust_window, sharing
from pipeline.mapping.submap_matching import MapFeatures, consistent_matches, features_of_map, find_matches
from pipeline.mapping.submap_merging import merge_maps
from pipeline.matching.keyframe_features import KeyframeFeatures
from pipeline.matching.place_recognition import VisualWords
from pipeline.matching.sift_cache import SiftCache
from pipeline.matching.sim3_match import Sim3Match
from pipeline.matching.sim3_ransac import similarity_errors
from pipeline.optimization.resection import reprojection_errors, robust_pose
from tests.helpers.camera_geometry import PINHOLE, camera_from_world_at, jacobians, on_plane, tube

RAYS = RayTable(PINHOLE)


def test_no_track_lies_where_the_lens_has_no_ray():
    """Equidistant, 100 px a radian: a pixel at 105 degrees has a table entry at 85. Texture goes to the corners."""
    rng = np.random.default_rng(0)
    image = np.repeat(rng.integers(60, 200, (80, 80, 1), dtype=np.uint8), 3, axis=2).repeat(4, 0).repeat(4, 1)
    fisheye = Camera("OPENCV_FISHEYE", 320, 320, (100.0, 100.0, 160.0, 160.0, 0.0, 0.0, 0.0, 0.0))
    mask = np.full((320, 320), 255, np.uint8)
    odometry = Odometry(RayTable(fisheye), 0)
    odometry.process(0, image, odometry.view(image, mask))
    angle = np.degrees(np.linalg.norm(odometry.initializer.tracks.now - 160, axis=1) / 100)
    assert len(angle) > 100
    assert angle.max() < 78
    assert angle.max() > 70  # and the limit costs no more than that
    assert set(np.unique(odometry.rays.masked(mask))) == {0, 255}


def test_deep_shadow_is_not_folded_up_to_grey():
    """Light wall with a few black specks: many standard deviations below its surroundings is black, not mid-grey."""
    image = np.full((100, 100, 3), 200, np.uint8)
    image[48:51, 48:51] = 0
    assert normalise(image)[49, 49] == 0


def test_noise_alone_has_no_pose():
    rng = np.random.default_rng(0)
    points, seen = tube(60, rng), rng.uniform(-1, 1, (60, 2))
    found = robust_pose(points, seen, jacobians(60), 1.0, rng)
    if found is not None:  # six points that agree by chance are no more than that
        assert (reprojection_errors(found, points, seen, jacobians(60)) < 1).mean() < 0.2


def a_map(centres, ids=None, points=None, seed=0):
    """Keyframes at `centres`, each seeing the tracks `ids` of it (all of them where not given)."""
    made = LocalMap(RAYS)
    world = tube(60, np.random.default_rng(seed)) if points is None else points
    made.tracks.points[: len(world)], made.tracks.has_point[: len(world)] = world, True
    for number, centre in enumerate(centres):
        mine = np.arange(len(world)) if ids is None else np.asarray(ids[number])
        camera_from_world = camera_from_world_at([0, 0, 0], centre)
        made.add_keyframe(number, camera_from_world, mine, 160 + 160 * on_plane(camera_from_world, world[mine])[0])
    return made


def test_a_window_is_held_by_those_that_share_its_points_wherever_they_are():
    """Keyframes 1 and 2 precede the window but share nothing with it; 0 and 5, far off in the list, do."""
    half, other = np.arange(30), np.arange(30, 60)
    centres = [[0, 0, 0.1 * k] for k in range(6)]
    made = a_map(centres, [half, other, other, half, half, half])
    held = sharing(made, made.keyframes[3:5], made.keyframes[:3] + made.keyframes[5:], 6)
    assert [keyframe.frame for keyframe in held] == [0, 5]
    before = [keyframe.camera_from_world.copy() for keyframe in made.keyframes]
    for number in (3, 4):
        made.keyframes[number].camera_from_world = camera_from_world_at([0.5, 0, 0], [0.1, 0, centres[number][2]])
    adjust_window(made, 2, 30, end=5)
    for keyframe, right in zip(made.keyframes, before, strict=True):
        np.testing.assert_allclose(keyframe.camera_from_world, right, atol=1e-3)


@pytest.mark.parametrize("stride", [1, 5])
def test_the_first_prediction_knows_the_stride(stride):
    """Two keyframes two working frames and 2 mm apart: 1 mm from one working frame to the next."""
    made = a_map([[0, 0, 0], [0, 0, 2]])
    made.keyframes[1].frame = 2 * stride
    tracker = Tracker.__new__(Tracker)
    tracker.map = made
    np.testing.assert_allclose(inverse(tracker._initial_velocity(stride))[:3, 3], [0, 0, 1], atol=1e-9)


def features_of(local_map, number, rows, codes):
    keyframe: Keyframe = local_map.keyframes[number]
    points = in_camera(keyframe.camera_from_world, local_map.tracks.points[keyframe.ids[rows]])
    return KeyframeFeatures(
        number, keyframe.pixels[rows], codes[rows], points, np.full(len(points), 3.0), np.zeros(len(points), bool)
    )


def linked(count=60, wrong=0, points=None, others=None):
    """Links of one place in two maps of the same wall (or of points and `others`), with `wrong` false matches."""
    rng = np.random.default_rng(1)
    codes = rng.integers(0, 255, (count, 128)).astype(np.uint8)
    points = tube(count, np.random.default_rng(0)) if points is None else points
    first, second = a_map([[0, 0, 0]], points=points), a_map([[1, 0, 1]], points=points if others is None else others)
    mixed = np.concatenate([np.roll(codes[:wrong], 1, axis=0), codes[wrong:]])
    place, other = features_of(first, 0, np.arange(count), codes), features_of(second, 0, np.arange(count), mixed)
    return find_matches(
        (MapFeatures(first, [place]), MapFeatures(second, [other])), rng, VisualWords.of([place, other], 0)
    )


def test_a_link_needs_matches_agreement_and_spread():
    assert len(linked(60)) == 1
    assert [match.inliers for match in linked(60, wrong=38)] == [20]  # two more right ones hardly move: static
    assert linked(60, wrong=39) == []  # one fewer
    assert len(linked(120, wrong=90)) == 1  # a quarter agrees
    assert linked(120, wrong=98) == []  # 22 agree, but of 120
    ridge = tube(60, np.random.default_rng(0))
    ridge[:, 1] = 0.02 * ridge[:, 1]
    assert linked(60, points=ridge) == []  # all on a line of the image


def test_one_thing_that_occurs_in_two_places_links_nothing():
    """Nine in twenty of the features are the same, rigid and spread; the wall around them is farther in one map, here
    more and there less. As many matches link where the wall is the same."""
    wall = tube(120, np.random.default_rng(0))
    elsewhere = wall.copy()
    elsewhere[54:] *= np.random.default_rng(1).uniform(1.4, 2.0, (66, 1))
    assert len(linked(120, wrong=66, points=wall)) == 1
    assert linked(120, points=wall, others=elsewhere) == []


def test_what_stands_still_in_the_picture_links_nothing():
    """Dirt on the lens: alike in two maps, at the same pixels, and with the map's depth around it."""
    codes = np.random.default_rng(1).integers(0, 255, (60, 128)).astype(np.uint8)
    for way, count in ((0.0, 0), (0.4, 0), (3.0, 1)):
        first, second = a_map([[0, 0, 0]]), a_map([[0, 0, 0]])
        place = features_of(first, 0, np.arange(60), codes)
        other = replace(place, pixels=place.pixels + np.array([way, 0]))
        maps = MapFeatures(first, [place]), MapFeatures(second, [other])
        assert len(find_matches(maps, np.random.default_rng(0), VisualWords.of([place, other], 0))) == count


@pytest.mark.parametrize(("apart", "joined"), [(0.0, False), (1.0, False), (10.0, True)])
def test_two_pairs_of_neighbours_are_one_piece_of_evidence(apart, joined):
    """Two keyframes of each map, so many mm apart along a lumen whose points lie some 50 mm ahead."""
    codes = np.random.default_rng(1).integers(0, 255, (60, 128)).astype(np.uint8)
    maps = [a_map([[0, 0, shift], [0, 0, shift + apart]]) for shift in (0.0, -4.0)]
    shown = tuple(MapFeatures(m, [features_of(m, number, np.arange(60), codes) for number in (0, 1)]) for m in maps)
    words = VisualWords.of([features for one in shown for features in one.features], 0)
    links = find_matches(shown, np.random.default_rng(0), words)
    assert len(links) == 4
    assert bool(consistent_matches(links, shown)) == joined
    assert consistent_matches(links[:1], shown) == []


@pytest.mark.parametrize(("keyframes", "joined"), [(2, False), (3, True)])
def test_one_match_is_enough_where_the_pairs_around_bear_it_out(keyframes, joined):
    """Keyframes 10 mm apart: four pairs around one match, or nine."""
    codes = np.random.default_rng(1).integers(0, 255, (60, 128)).astype(np.uint8)
    maps = [a_map([[0, 0, shift + 10 * k] for k in range(keyframes)]) for shift in (0.0, -4.0)]
    shown = tuple(
        MapFeatures(m, [features_of(m, number, np.arange(60), codes) for number in range(keyframes)]) for m in maps
    )
    words = VisualWords.of([features for one in shown for features in one.features], 0)
    links = find_matches(shown, np.random.default_rng(0), words)
    assert bool(consistent_matches(links[:1], shown)) == joined


def matches_of_one_world(count, rng):
    """Matches of as many keyframes of two maps of one world, each off by a millimetre or two."""
    maps = LocalMap(RAYS), LocalMap(RAYS)
    features, matches = ([], []), []
    for number in range(count):
        points = tube(int(rng.integers(30, 60)), rng)
        poses = [camera_from_world_at(rng.uniform(-4, 4, 3), rng.normal(0, 2, 3)) for _ in maps]
        for made, of, camera in zip(maps, features, poses, strict=True):
            pixels = 160 + 160 * on_plane(camera, points)[0]
            made.add_keyframe(number, camera, np.zeros(0, np.int64), np.zeros((0, 2)))
            codes, flags = np.zeros((len(points), 128), np.uint8), np.zeros(len(points), bool)
            of.append(KeyframeFeatures(number, pixels, codes, in_camera(camera, points), flags + 3.0, flags))
        off = np.eye(4)
        off[:3, 3] = rng.normal(0, 1.5, 3)
        rows = np.repeat(np.arange(len(points))[:, None], 2, axis=1)
        matches.append(Sim3Match(number, number, poses[0] @ off @ inverse(poses[1]), rows))
    return tuple(MapFeatures(*pair) for pair in zip(maps, features, strict=True)), matches


def test_matches_that_agree_are_found_as_one_by_one():
    maps, matches = matches_of_one_world(20, np.random.default_rng(2))
    far = np.eye(4)
    far[:3, 3] = 40  # explains no other, and no other explains it: its points are moved too
    matches[4] = replace(matches[4], first_from_second=matches[4].first_from_second @ far)
    moved = maps[1].features[4]
    maps[1].features[4] = replace(moved, points=moved.points + 15, pixels=moved.pixels + 60)

    def explains(one, other):
        sides = (
            maps[0].correspondences(other.first, other.rows[:, 0]),
            maps[1].correspondences(other.second, other.rows[:, 1]),
        )
        errors = similarity_errors(submap_matching.second_from_first(one, maps), *sides)
        return (errors < submap_matching.MAX_SAME_PX).mean() >= submap_matching.SAME_SHARE

    one_by_one = np.array([[explains(one, other) for other in matches] for one in matches])
    assert 0.3 < one_by_one.mean() < 0.97
    assert (one_by_one != one_by_one.T).any()
    np.testing.assert_array_equal(submap_matching._explained(matches, maps), one_by_one)
    agreeing = submap_matching._agreeing(matches, maps)
    assert len(agreeing) == one_by_one.sum(axis=1).max()
    assert not any(match is matches[4] for match in agreeing)


def test_a_pair_of_places_is_compared_once(monkeypatch):
    """Maps 0 and 2 are one place, map 1 is none: after the join only what map 0 gained is shown to map 1."""
    maps = [a_map([[0, 0, 0], [0, 0, 9]], seed=seed) for seed in (0, 5, 0)]
    codes = [np.random.default_rng(seed).integers(0, 255, (60, 128)).astype(np.uint8) for seed in (0, 5, 0)]
    shown = {id(m): [features_of(m, k, np.arange(60), c) for k in (0, 1)] for m, c in zip(maps, codes, strict=True)}
    seen, real = [], submap_matching.verify_match

    def verify(numbers, first, second, *rest, **options):
        seen.append((id(first.descriptors), first.keyframe, id(second.descriptors), second.keyframe))
        return real(numbers, first, second, *rest, **options)

    monkeypatch.setattr(submap_merging, "features_of_map", lambda m, find: shown[id(m)])
    monkeypatch.setattr(submap_matching, "verify_match", verify)
    assert [whole.members for whole in merge_maps(maps, None, 0)] == [(0, 2), (1,)]
    assert len(set(seen)) == len(seen) == 12


def test_descriptors_are_kept_in_a_byte_each():
    rng = np.random.default_rng(0)
    image = np.repeat(rng.integers(60, 200, (80, 80, 1), dtype=np.uint8), 3, axis=2).repeat(4, 0).repeat(4, 1)
    (place,) = features_of_map(a_map([[0, 0, 0]]), SiftCache(lambda _: (image, np.full((320, 320), 255, np.uint8))))
    assert place.descriptors.dtype == np.uint8
    np.testing.assert_allclose(np.linalg.norm(place.rootsift, axis=1), 1, atol=1e-3)
