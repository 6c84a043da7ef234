"""The second front end: of which stretches it is asked, for how long, and what is kept of both."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from haustra.core.errors import HaustraError
from haustra.core.progress import SilentProgress
from pipeline.config import Config
from pipeline.frontend import structure_stage
from pipeline.frontend.scoring import uncovered
from pipeline.frontend.second_opinion import (
    BY_LIGHT_ALONE,
    MARGIN,
    Opinion,
    Stretch,
    ask_of_each,
    joined,
    stretches_in_doubt,
    stretches_to_ask,
    thinned_to,
)
from pipeline.matching.sift_cache import SiftCache
from tests.helpers.candidates import GOOD, Given, many_frames, map_of

SETTINGS = Config().front_end_settings
NO_FEATURES = SiftCache(None)  # nobody asks for any


def test_only_stretches_without_a_sure_map_are_in_doubt():
    frames = many_frames(300)
    sure, dark = map_of(range(100)), map_of(range(150, 200), 0.3)
    short_gap = map_of(range(210, 300))
    (asked,) = stretches_in_doubt([sure, dark, short_gap], frames)
    assert asked.frames.index.tolist() == list(range(100 - MARGIN, 210 + MARGIN))
    assert asked.doubtful.tolist() == list(range(100, 210))
    np.testing.assert_array_equal(asked.frames.seconds, asked.frames.index / 30)
    assert stretches_in_doubt([map_of(range(100)), map_of(range(110, 300))], frames) == []  # 10 are too few
    assert [len(one.frames.index) for one in stretches_in_doubt([dark], frames)] == [300]
    two = stretches_in_doubt([map_of(range(60, 100)), map_of(range(140, 300))], frames)
    assert [(one.frames.index[0], one.frames.index[-1] + 1) for one in two] == [(90, 150), (0, 70)], (
        "the shortest first"
    )


@pytest.mark.parametrize(
    ("most", "asked", "every"),
    [
        (1240, [310, 320, 610], 1),
        (1239, [310, 320, 610], 2),
        (211, [310, 320, 610], 6),
        (210, [310, 320], 6),
        (50, [], 6),
    ],
)
def test_too_many_frames_are_thinned_and_then_the_longest_stretches_are_left_out(most, asked, every):
    found = [map_of(range(300, 1200)), map_of(range(1500, 1800))]  # in doubt: 0 to 300, 1200 to 1500, 1800 to 2400
    stretches, found_every = thinned_to(stretches_in_doubt(found, many_frames(2400)), most)
    assert [len(one.frames.index) for one in stretches] == asked
    assert found_every == every
    assert thinned_to([], most) == ([], 1)


def test_maps_that_may_well_be_wrong_are_in_doubt_however_clear_their_light():
    def doubted(probability):
        return replace(map_of(range(100)), doubt=SimpleNamespace(probability=probability))

    frames = many_frames(300)
    (asked,) = stretches_in_doubt([doubted(0.21), map_of(range(100, 300))], frames)
    assert asked.doubtful.tolist() == list(range(100))
    assert stretches_in_doubt([doubted(0.19), map_of(range(100, 300))], frames) == []
    assert stretches_in_doubt([doubted(0.6), map_of(range(100, 300))], frames, BY_LIGHT_ALONE) == []


@pytest.mark.parametrize(
    ("wrong", "begin", "asked", "left"),
    [
        ((0, 1000), 0, [], [1000]),
        ((0, 500), 0, [510], []),
        ((0, 700), 60, [40, 70], []),
        ((300, 1000), 40, [40, 50], []),
    ],
)
def test_of_what_does_not_fit_the_choice_that_asks_about_more_frames_is_taken(wrong, begin, asked, left):
    """Frames before `begin` and from 1000 to 1030 are in no map, others in one that is right or probably wrong."""
    doubtful = replace(map_of(range(max(begin, wrong[0]), wrong[1])), doubt=SimpleNamespace(probability=0.9))
    maps = [doubtful, map_of([*range(begin, wrong[0]), *range(wrong[1], 1000)])]
    total = 1000 if begin == 0 else 1030
    fit, _, left_out = stretches_to_ask(maps, many_frames(total), 120)
    assert [len(one.frames.index) for one in fit] == asked
    assert [len(one.frames.index) for one in left_out] == left


def stretch_of(begin, end, margin=MARGIN):
    """What is in doubt from one frame to another, and some frames around it."""
    index = np.arange(max(0, begin - margin), end + margin)
    return Stretch(replace(many_frames(len(index)), index=index, seconds=index / 30), np.arange(begin, end))


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


@pytest.mark.parametrize("error", [KeyboardInterrupt(), HaustraError("features and matches failed")])
def test_what_is_finished_stays_when_another_stretch_fails(tmp_path, error):
    """The second of three stretches fails: an interrupt ends the comparison, an error does not."""
    asked = []

    def run(frames):
        asked.append(int(frames.index[0]))
        if len(asked) == 2:
            raise error
        return {"global": []}

    stretches = [stretch_of(20, 40), stretch_of(100, 130), stretch_of(200, 240)]
    opinions, failure = ask_of_each(stretches, run, None, tmp_path, SilentProgress())
    interrupted = isinstance(error, KeyboardInterrupt)
    assert asked == ([10, 90] if interrupted else [10, 90, 190])
    assert len(opinions) == (1 if interrupted else 2)
    assert failure == (None if interrupted else str(error))


def test_the_sentence_names_the_mappers_of_what_is_kept():
    both = structure_stage._sentence([map_of(range(60)), map_of(range(50, 90), mapper="global")], 100)
    assert both.startswith("90 of 100 frames posed in 2 submaps by the odometry and global mappers: 600 points")
    assert " by the odometry mapper: " in structure_stage._sentence([GOOD], 100)
