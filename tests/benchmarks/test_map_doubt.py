"""The fit of a map's doubt: known coefficients are found, signs are held, and films that had no part judge."""

import numpy as np
import pytest
from scipy.special import expit

from benchmarks.map_doubt.fitting import chosen_predictors, fitted, log_loss, probabilities_left_out
from benchmarks.map_doubt.rows import path_of


def drawn(count=4000):
    rng = np.random.default_rng(0)
    predictors = rng.normal(size=(count, 2)) * [1.0, 3.0]
    wrong = rng.random(count) < expit(-1 + 2 * predictors[:, 0] - 0.5 * predictors[:, 1])
    return predictors, wrong, [str(number % 8) for number in range(count)]


def test_known_weights_are_found_and_none_is_negative():
    predictors, wrong, _ = drawn()
    offset, weights = fitted(predictors * [1, -1], wrong)
    assert offset == pytest.approx(-1, abs=0.15)
    assert weights == pytest.approx([2, 0.5], abs=0.15)
    assert fitted(predictors, wrong)[1][1] == 0


def test_a_predictor_that_tells_nothing_is_not_chosen():
    predictors, wrong, group = drawn(800)
    noise = np.random.default_rng(1).normal(size=800)
    chosen = chosen_predictors({"told": predictors[:, 0], "noise": noise, "also": -predictors[:, 1]}, wrong, group)
    assert [name for name, _ in chosen] == ["told", "also"]
    assert chosen[1][1] < chosen[0][1]


def test_a_group_has_no_part_in_its_own_probability():
    predictors, wrong, group = drawn(400)
    mine = np.array(group) == "3"
    turned = np.where(mine, ~wrong, wrong)
    one, other = (probabilities_left_out(predictors, of, group) for of in (wrong, turned))
    assert np.allclose(one[mine], other[mine])
    assert not np.allclose(one[~mine], other[~mine])


def test_knowing_nothing_costs_ln_2():
    assert log_loss(np.full(4, 0.5), np.array([True, False, True, False])) == pytest.approx(np.log(2))


def test_walls_of_one_path_are_one_group():
    assert {path_of(name) for name in ("d_0.0", "d_2.5", "d_10")} == {"d"}
    assert path_of("scope_03") == "scope_03"
    assert path_of("long_a") == "long_a"
