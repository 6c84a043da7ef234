"""The note on coverage, the error that runs are told, and the fit of their regions' probability are the record's."""

import json

import numpy as np
import pytest

from benchmarks.common.record import ROOT
from benchmarks.coverage_regions import fitted, regions_of
from pipeline.surface.coverage_stage import ERROR_POINTS
from reconstruction.coverage.missed_regions import OFFSET, SLOPE, hidden_probability
from scripts.pages.surface.coverage_page import RECORD, not_chosen, page, rms


@pytest.fixture(scope="module")
def record():
    return json.loads(RECORD.read_text())


def test_the_page_is_what_its_record_says():
    committed = (ROOT / "docs/lab/coverage.md").read_text(encoding="utf-8")
    assert page() == committed, "run: python -m scripts.pages.surface.coverage_page > docs/lab/coverage.md"


def test_the_error_that_runs_are_told_is_that_of_films_that_nothing_was_chosen_on(record):
    assert pytest.approx(rms(not_chosen(record)), abs=0.05) == ERROR_POINTS


def test_the_probability_of_a_region_is_fitted_on_films_that_are_not_reported(record):
    assert fitted(*regions_of(record, "chosen"))[0] == pytest.approx((OFFSET, SLOPE), abs=0.01)


def test_the_fit_finds_the_coefficients_that_made_the_regions():
    rng = np.random.default_rng(0)
    reach = rng.uniform(0.03, 0.5, 20000)
    is_true = rng.random(20000) < 1 / (1 + np.exp(-(5 + 3 * np.log(reach))))
    found, sigma = fitted(reach, is_true)
    assert (np.abs(found - (5, 3)) < 3 * sigma).all()
    assert (sigma < 0.1).all()


def test_what_reaches_farther_is_more_likely_hidden():
    told = hidden_probability(np.linspace(0, 1, 50))
    assert (np.diff(told) > 0).sum() >= 48
    assert hidden_probability(np.exp(-OFFSET / SLOPE)) == pytest.approx(0.5)
    assert told[0] < 0.01
    assert told[-1] > 0.99
