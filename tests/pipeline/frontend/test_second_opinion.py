"""The second front end: of which stretches it is asked, for how long, and what is kept of both."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from haustra.core.errors import HaustraError
from haustra.core.progress import SilentProgress
from pipeline.config import Config
from pipeline.frontend import structure_stage
from pipeline.frontend.second_opinion import (
    BY_LIGHT_ALONE,
    MARGIN,
    ask_of_each,
    stretches_in_doubt,
    stretches_to_ask,
    thinned_to,
)
from pipeline.matching.sift_cache import SiftCache
from tests.helpers.candidates import GOOD, many_frames, map_of, stretch_of

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
    assert both.startswith("90 of 100 frames posed in 2 submaps by the odometry and global mappers: the first, of 60")
    assert " by the odometry mapper: " in structure_stage._sentence([GOOD], 100)
