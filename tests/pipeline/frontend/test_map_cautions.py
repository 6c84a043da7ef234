"""What a user is told of a doubtful map."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from pipeline.frontend.map_cautions import advice_after, carried_by_depth, doubts_of_submaps, few_posed
from tests.helpers.candidates import DARK


def with_camera(camera):
    return SimpleNamespace(record={"config": {"camera": camera}})


@pytest.mark.parametrize(
    ("front_ends", "camera", "advice"),
    [
        (["odometry"], "auto", "compare with --front-end sfm, or use other frames"),
        (["odometry", "sfm"], "auto", "use other frames"),
        (["sfm"], "auto", "compare with --front-end odometry, or use other frames"),
        (["odometry", "sfm"], "lens.yaml", "check that the lens is this film's (--camera), use other frames"),
    ],
)
def test_what_was_not_tried_is_advised(front_ends, camera, advice):
    assert advice_after(front_ends, with_camera(camera)) == advice


def test_light_that_contradicts_a_submap_is_told():
    (sentence,) = doubts_of_submaps([DARK], "use other frames")
    assert sentence.endswith("in 40 % of 90 frames nearer points are darker; use other frames")


def test_where_there_is_a_probability_light_alone_says_nothing():
    sure, likely = (SimpleNamespace(sentence=lambda *_, told=told: told) for told in (None, "is probably wrong"))
    assert doubts_of_submaps([replace(DARK, doubt=sure)], "") == []
    assert doubts_of_submaps([replace(DARK, doubt=likely)], "") == ["is probably wrong"]


def test_a_map_too_short_to_be_judged_is_told_once():
    lit = replace(DARK, mapper="odometry", check=replace(DARK.check, frames=5, inconsistent_share=0.0))
    (sentence,) = doubts_of_submaps([lit, lit], "")
    assert sentence.startswith("submap 0 has 5 frames, and it takes 20 to judge")
    assert doubts_of_submaps([replace(lit, mapper="poses")], "") == []
    assert doubts_of_submaps([replace(lit, check=replace(lit.check, frames=20))], "") == []


def test_a_film_of_which_little_is_posed_is_told():
    assert few_posed(17, 80, "use other frames") == ["only 17 of 80 usable frames have a pose; use other frames"]
    assert few_posed(40, 80, "use other frames") == []


def test_a_map_that_depth_alone_carries_is_told():
    assert carried_by_depth(0) == []
    assert carried_by_depth(1)[0].startswith("one stretch without usable pictures is carried over")
    assert carried_by_depth(3)[0].startswith("each of 3 stretches without usable pictures is carried over")
