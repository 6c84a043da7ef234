"""Which maps are kept of two front ends."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.frontend import joined_maps
from pipeline.frontend.joined_maps import joined
from pipeline.frontend.scoring import part_of, uncovered
from pipeline.frontend.second_opinion import Opinion, stretches_in_doubt
from pipeline.mapping.submap import Submap, read_submap
from tests.helpers.candidates import GOOD, Given, many_frames, map_of, shorter, stretch_of


def global_(frames, inconsistent=0.0):
    return map_of(frames, inconsistent, "global")


def incremental(frames):
    return map_of(frames, 0.0, "incremental")


def shown(maps):
    """Of each map, who made it and its first and last frame."""
    return sorted((one.mapper, int(one.submap.frames[0]), int(one.submap.frames[-1])) for one in maps)


def test_a_sure_map_between_two_stretches_that_touch_stays():
    sure = map_of(range(90, 110))
    first = [sure, map_of(range(85), 0.5), map_of(range(115, 200), 0.5)]
    (stretch,) = stretches_in_doubt(first, many_frames(200))
    assert len(stretch.frames.index) == 200
    assert len(stretch.doubtful) == 180
    found = joined(first, 200, [Opinion(stretch, {"global": [global_(range(88)), global_(range(112, 200))]})])
    assert shown(found["global"]) == [("global", 0, 87), ("global", 112, 199), ("odometry", 90, 109)]
    assert shown(joined(first, 200, [Opinion(stretch, {"global": []})])["global"]) == [("odometry", 90, 109)]


@pytest.mark.parametrize("good", [True, False])
def test_stretches_that_one_map_spans_are_decided_together(good):
    """A map that was merged over three stretches, 60 frames in each, which the light contradicts."""
    parts = [(0, 60), (160, 220), (320, 380)]
    dark = map_of(np.concatenate([np.arange(*part) for part in parts]), 0.4)
    sure = [map_of(range(60, 160)), map_of(range(220, 320))]
    theirs = [global_(range(b, e)) if good else global_(range(b, b + 5)) for b, e in parts]
    opinions = [Opinion(stretch_of(*part), {"global": [one]}) for part, one in zip(parts, theirs, strict=True)]
    found = joined([dark, *sure], 380, opinions)["global"]
    assert sum(one is dark for one in found) == 0
    assert len(found) == 5
    right = map_of(dark.submap.frames, 0.06)  # a little too dark to be sure
    poor = [Opinion(stretch_of(*part), {"global": [global_(range(part[0], part[0] + 5))]}) for part in parts]
    assert joined([right, *sure], 380, poor) == {}, "the first one's is better, and nothing of the second's is kept"


@pytest.mark.parametrize(("probability", "frames", "taken"), [(0.8, 59, True), (0.8, 55, False), (0.5, 120, False)])
@pytest.mark.parametrize("alone", [True, False])
def test_a_map_that_the_light_contradicts_is_not_given_up_for_fewer_frames_than_it_may_pose_rightly(
    probability, frames, taken, alone
):
    dark = replace(map_of(range(200), 0.4), doubt=SimpleNamespace(probability=probability))
    opinions = [Opinion(stretch_of(0, 200), {"global": [global_(range(frames))]})]
    opinions += [] if alone else [Opinion(stretch_of(300, 320), {"global": []})]
    found = joined([dark, map_of(range(200, 300))], 320, opinions)
    assert ("global", 0, frames - 1) in shown(found.get("global", [])) if taken else not found.get("global")


def test_of_two_maps_that_the_light_contradicts_the_one_that_hangs_together_wins():
    dark = replace(map_of(range(140), 0.06), doubt=SimpleNamespace(probability=0.7))
    theirs = replace(global_(range(200), 0.08), doubt=SimpleNamespace(probability=0.6))
    opinion = Opinion(stretch_of(0, 200), {"global": [theirs]})
    assert shown(joined([dark], 200, [opinion])["global"]) == [("global", 0, 199)]


def test_a_clean_map_is_not_given_up_for_margins_nor_for_one_that_would_be_dropped():
    first = [map_of(range(100)), map_of(range(120, 250)), map_of(range(100, 120)), map_of(range(270, 400))]
    far, near = Opinion(stretch_of(250, 270), {"global": []}), stretch_of(100, 120)
    assert joined(first, 400, [Opinion(near, {"global": [global_(range(90, 130), 0.14)]}), far]) == {}
    assert joined(first, 400, [Opinion(near, {"global": [global_(range(90, 130), 0.04)]}), far]) == {}
    first[2] = map_of(range(100, 105))
    found = joined(first, 400, [Opinion(near, {"global": [global_(range(90, 130))]}), far])
    assert ("global", 90, 129) in shown(found["global"])
    assert ("odometry", 100, 104) not in shown(found["global"])


def test_of_each_stretch_the_better_mapper_counts():
    opinions = [
        Opinion(
            stretch_of(0, 60), {"global": [global_(range(60))], "incremental": [map_of(range(9), 0, "incremental")]}
        ),
        Opinion(stretch_of(160, 220), {"global": [], "incremental": [map_of(range(160, 220), 0, "incremental")]}),
        Opinion(stretch_of(320, 380), {"global": []}),
    ]
    found = joined([map_of(range(60, 160)), map_of(range(220, 320))], 380, opinions)
    assert list(found) == ["global and incremental"]
    assert shown(found["global and incremental"])[:2] == [("global", 0, 59), ("incremental", 160, 219)]


def test_a_map_that_only_has_frames_of_others_goes():
    first = [map_of(range(100)), map_of(range(130, 400))]
    theirs = {"global": [global_(range(90, 135)), global_(range(92, 99))]}
    assert shown(joined(first, 400, [Opinion(stretch_of(100, 130), theirs)])["global"]) == [
        ("global", 90, 134),
        ("odometry", 0, 99),
        ("odometry", 130, 399),
    ]
    covered = [replace(GOOD, submap=Given(np.arange(*span))) for span in ((0, 100), (80, 97), (95, 140))]
    assert uncovered(covered) == [covered[0], covered[2]]


@pytest.mark.parametrize("alone", [True, False])
def test_frames_that_only_the_map_that_gave_way_poses_stay(monkeypatch, alone):
    """COLMAP's maps are right, and end before odometry's, of which one lies where they pose nothing."""
    monkeypatch.setattr(joined_maps, "part_of", shorter)

    def wrong(frames):
        return replace(map_of(frames), doubt=SimpleNamespace(probability=0.9))

    first = [wrong(range(120)), wrong(range(120, 180)), wrong(range(180, 240)), wrong(range(50, 70))]
    theirs = {"global": [global_(range(90)), global_(range(122, 161))]}
    opinions = [Opinion(stretch_of(0, 240), theirs)]
    opinions += [] if alone else [Opinion(stretch_of(300, 320), {"global": []})]
    (found,) = joined([*first, map_of(range(240, 300))], 320, opinions).values()
    assert shown(found) == [
        ("global", 0, 89),
        ("global", 122, 160),
        ("odometry", 90, 119),
        ("odometry", 120, 179),  # frames 120, 121 and 161 to 179
        ("odometry", 180, 239),
        ("odometry", 240, 299),
    ]
    counts = [len(one.submap.frames) for one in found]
    assert counts == sorted(counts, reverse=True) == [one.check.frames for one in found]
    assert sum(counts) == 300, "no frame is posed twice"
    assert [one.doubt is None for one in found if one.mapper == "odometry"] == [True, False, False, False]


@pytest.mark.parametrize(
    "given_up",
    [
        map_of(range(119)),
        map_of(range(130), 0.06),
        replace(map_of(range(130)), submap=Given(np.arange(130), (), (9.0,))),
    ],
    ids=["too few", "against the light", "another lens"],
)
def test_not_all_that_gave_way_stays(given_up):
    doubted = replace(given_up, doubt=SimpleNamespace(probability=0.9))
    found = joined([doubted], 130, [Opinion(stretch_of(0, 130), {"global": [global_(range(100))]})])
    assert shown(found["global"]) == [("global", 0, 99)]


def test_a_part_of_a_map_is_written_with_its_own_frames_and_points(tmp_path):
    rng, frames, points = np.random.default_rng(0), np.arange(10, 30), 50
    seen = np.argwhere(rng.uniform(size=(len(frames), points)) < 0.3)  # each point in six frames, in the mean
    pixels = rng.uniform(0, 200, (len(seen), 2))
    poses = np.tile(np.eye(4), (len(frames), 1, 1))
    poses[:, :3, 3] = rng.normal(size=(len(frames), 3))
    whole = Submap(frames, poses, rng.normal(size=(points, 3)), np.ones(points), seen, pixels, (200.0,))
    one = replace(GOOD, submap=whole, folder=tmp_path / "0_written")
    part = part_of(one, {int(frame) for frame in whole.frames[5:12]})
    read = read_submap(part.folder)
    assert read.frames.tolist() == whole.frames[5:12].tolist()
    np.testing.assert_array_equal(read.world_from_camera, whole.world_from_camera[5:12])
    assert part.check.frames == 7
    assert part.doubt is one.doubt
    assert (read.track_lengths() >= 2).all()
    assert 0 < len(read.points) < len(whole.points)
    assert not one.folder.exists(), "the whole map is left as it is"
