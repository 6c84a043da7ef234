"""A map's probability of being wrong grows with each predictor against it, and its words follow the probability."""

from dataclasses import replace

import pytest

from pipeline.mapping.map_doubt import (
    FAMILY,
    PREDICTORS,
    PROBABLE,
    SURE,
    UNKNOWN,
    MapDoubt,
    MapEvidence,
    coefficients,
)
from pipeline.mapping.map_doubt import judge as judge_of_family
from pipeline.mapping.readjustment import PathDifference

RIGHT = MapEvidence(0.4, 6.0, 20.0, 2.0, -0.9, 0.0, 1.0, 1, PathDifference(0.001, 0.2), PathDifference(0.007, 0.8))
WRONG = MapEvidence(0.6, 1.0, 5.0, 0.4, 0.1, 0.5, 0.1, 7, PathDifference(0.03, 4.0), PathDifference(0.06, 12.0))


def judge(evidence):
    return judge_of_family(evidence, "odometry")


def test_a_right_map_is_sure_and_a_wrong_one_is_not():
    assert judge(RIGHT).probability < SURE
    assert judge(WRONG).probability > PROBABLE


@pytest.mark.parametrize("name", list(RIGHT.__dataclass_fields__))
def test_nothing_against_a_map_makes_it_surer(name):
    worse = replace(RIGHT, **{name: getattr(WRONG, name)})
    assert judge(worse).probability >= judge(RIGHT).probability
    assert all(predictor.of(worse) >= predictor.of(RIGHT) for predictor in PREDICTORS.values())


def test_weights_have_the_sign_that_physics_demands():
    assert {"odometry"} <= set(coefficients()) <= set(FAMILY.values())
    for fitted in coefficients().values():
        assert set(fitted["weights"]) <= set(PREDICTORS)
        assert min(fitted["weights"].values()) >= 0


def test_a_map_without_parts_has_nothing_to_speak_for_it():
    alone = replace(RIGHT, stretches=None, halves=None)
    assert judge(alone).probability == judge(replace(RIGHT, stretches=UNKNOWN, halves=UNKNOWN)).probability
    assert judge(alone).probability > judge(RIGHT).probability


def test_words_follow_the_probability():
    told = {p: MapDoubt(p, "its points slide", RIGHT).sentence(2, "use other frames") for p in (0.04, 0.2, 0.8)}
    assert told[0.04] is None
    assert told[0.2].startswith("submap 2 may be wrong (probability 20 %) and is to be trusted with care: its points")
    assert told[0.8].startswith("submap 2 is probably wrong (probability 80 %) and is not to be trusted: its points")
    assert told[0.8].endswith("; use other frames")


def test_the_heaviest_predictor_is_put_into_words():
    dark = judge(replace(RIGHT, spearman=0.4))
    assert "less clearly than in most right maps (rank correlation 0.40, -1 at best)" in dark.heaviest
    torn = judge(replace(RIGHT, stretches=PathDifference(0.2, 40.0)))
    assert "by the whole and by two thirds of its frames differ by 20.0 % of the path and 40.0 degrees" in torn.heaviest
