"""Which maps are kept of two front ends."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.frontend import scoring
from pipeline.frontend.joined_maps import joined, with_rests
from pipeline.frontend.scoring import Candidate, part_of, uncovered
from pipeline.frontend.second_opinion import Opinion, stretches_in_doubt
from pipeline.mapping.submap import Submap, read_submap
from tests.helpers.candidates import DARK, GOOD, Given, many_frames, map_of, stretch_of


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


def mapped(frames, params=(200.0,), wrong=0.3, folder=None):
    """A map of these frames in which each sees 20 points of its own and of its neighbours."""
    frames, rng = np.asarray(frames), np.random.default_rng(0)
    row = np.repeat(np.arange(len(frames)), 20)
    point = (10 * row + np.tile(np.arange(20), len(frames))) % (10 * len(frames))
    poses = np.tile(np.eye(4), (len(frames), 1, 1))
    poses[:, :3, 3] = rng.normal(size=(len(frames), 3))
    points = rng.normal((0, 0, 9), 1, (10 * len(frames), 3))
    seen = np.stack([row, point], axis=1)
    submap = Submap(frames, poses, points, np.ones(len(points)), seen, rng.uniform(1, 63, (len(seen), 2)), params)
    check = replace(GOOD.check, frames=len(frames))
    return Candidate(submap, check, folder or Path(), "odometry", SimpleNamespace(probability=wrong))


def grey(_):
    return np.full((64, 64, 3), 90, np.uint8)


def lit(submap, _):
    """In place of `check_lighting`: nothing speaks against it."""
    return replace(GOOD.check, frames=len(submap.frames))


@pytest.fixture
def in_light(monkeypatch):
    monkeypatch.setattr(scoring, "check_lighting", lit)


def test_frames_that_only_a_map_poses_that_gave_way_stay(in_light, tmp_path):
    """COLMAP's maps end before odometry's, of which one lies where they pose nothing."""
    first = [mapped(range(120), folder=tmp_path / "0_written"), mapped(range(120, 180), folder=tmp_path / "1_written")]
    first += [mapped(range(180, 240)), mapped(range(240, 300), wrong=0.1)]
    kept = [mapped(range(90)), mapped(range(122, 150)), first[3]]
    found = with_rests(kept, first, grey)
    assert [(int(one.submap.frames[0]), len(one.submap.frames)) for one in found] == [
        (0, 90),
        (240, 60),
        (180, 60),
        (90, 30),
        (150, 30),
        (122, 28),
    ], "frames 120 and 121 are too few for a submap"
    assert [one.check.frames for one in found] == [len(one.submap.frames) for one in found]
    assert found[2] is first[2]
    for part, number in ((found[3], 0), (found[4], 1)):
        read = read_submap(part.folder)
        assert part.folder.name == f"{number}_written_part"
        assert read.frames.tolist() == part.submap.frames.tolist()
        assert (read.track_lengths() >= 2).all()
        assert len(read.points) > 0
        assert part.doubt is first[number].doubt


@pytest.mark.parametrize(
    "given_up",
    [
        mapped(range(119)),
        mapped(range(130), wrong=0.5),
        mapped(range(130), params=(9.0,)),
        mapped(range(0, 200, 5)),
    ],
    ids=["too few", "probably wrong", "another lens", "here and there"],
)
def test_not_all_that_gave_way_stays(given_up, in_light, tmp_path):
    kept = [mapped([frame for frame in range(200) if frame < 100 or frame % 10])]
    if len(given_up.submap.frames) > 40:
        kept = [mapped(range(100))]
    assert with_rests(kept, [replace(given_up, folder=tmp_path / "0_written")], grey) == kept


def test_a_part_that_the_light_contradicts_goes(monkeypatch, tmp_path):
    """What was measured of the whole map says nothing of its end."""
    monkeypatch.setattr(scoring, "check_lighting", lambda submap, _: replace(DARK.check, frames=len(submap.frames)))
    kept = [mapped(range(100))]
    assert with_rests(kept, [mapped(range(140), folder=tmp_path / "0_written")], grey) == kept


def test_frames_that_see_too_little_are_in_no_part(in_light, tmp_path):
    """Points that the frames before saw are not the part's."""
    one = mapped(range(130), folder=tmp_path / "0_written")
    seen = one.submap.observations
    blind = (seen[:, 0] >= 105) & (seen[:, 0] < 108)
    submap = replace(one.submap, observations=seen[~blind], pixels=one.submap.pixels[~blind])
    part = with_rests([mapped(range(100))], [replace(one, submap=submap)], grey)[1]
    assert part.submap.frames.tolist() == [*range(100, 105), *range(108, 130)]


def test_the_real_check_of_light_looks_at_the_part(tmp_path):
    one = mapped(range(130), folder=tmp_path / "0_written")
    part = part_of(one, np.arange(100, 130), grey)
    assert part.check.frames == 30
    assert part.check.points == len(part.submap.points)
    assert part_of(one, one.submap.frames, grey) is one
