"""Drift of a long path, against a path whose scale is known at every point."""

import numpy as np
import pytest

from benchmarks.long_video import drift
from pipeline.mapping.submap import Submap


def path(scale: np.ndarray) -> tuple[Submap, np.ndarray]:
    """A helix of 1 mm steps, and a submap whose step k is 1 / scale[k] units; shared orientations."""
    turn = np.linspace(0, 12 * np.pi, len(scale))
    steps = np.stack([0.6 * np.cos(turn), 0.6 * np.sin(turn), np.full(len(turn), 0.8)], axis=1)
    truth = np.tile(np.eye(4), (len(scale), 1, 1))
    mine = truth.copy()
    truth[1:, :3, 3] = np.cumsum(steps[1:], axis=0)
    mine[1:, :3, 3] = np.cumsum(steps[1:] / scale[1:, None], axis=0)
    empty = np.zeros((0, 2), np.int64)
    frames = np.arange(len(scale))
    return Submap(frames, mine, np.zeros((0, 3)), np.zeros(0), empty, np.zeros((0, 2)), ()), truth


def test_a_path_of_one_scale_does_not_drift():
    submap, truth = path(np.full(500, 3.0))
    found = drift([submap], truth, 100.0)
    assert found["stretches"] == 8
    assert found["scale_off_percent"] == pytest.approx([0, 0], abs=1e-6)
    assert found["end_error_percent"] == pytest.approx([0, 0], abs=1e-6)


def test_the_scale_of_each_stretch_is_found_where_it_grows_evenly():
    """By a tenth over 500 mm: the first and last of eight stretches begin at 0 and 350 mm, 3.5 % on either side."""
    submap, truth = path(np.linspace(1.0, 1.1, 500))
    found = drift([submap], truth, 100.0)
    assert found["scale_off_percent"][1] == pytest.approx(3.4, abs=0.4)
    assert 0.5 < found["end_error_percent"][0] < 2.0


def test_a_step_of_the_scale_is_an_end_error_of_the_stretches_across_it_alone():
    """Behind a step of a tenth, half a stretch is 10 % too short: its end is off by about 5 % of the whole."""
    submap, truth = path(np.where(np.arange(500) < 250, 1.0, 1.1))
    found = drift([submap], truth, 100.0)
    assert found["end_error_percent"][1] == pytest.approx(4.5, abs=1.5)
    assert found["end_error_percent"][0] < 1e-6


def test_a_path_shorter_than_a_stretch_has_none():
    submap, truth = path(np.ones(60))
    nothing = {"stretches": 0, "scale_off_percent": None, "end_error_percent": None}
    assert drift([submap], truth, 100.0) == nothing


def test_the_scale_of_one_or_two_stretches_is_compared_with_nothing():
    """It would be no drift, whatever the scale does."""
    submap, truth = path(np.linspace(1.0, 1.5, 176))
    found = drift([submap], truth, 100.0)
    assert found["stretches"] == 2
    assert found["scale_off_percent"] is None
    assert found["end_error_percent"][0] > 1
