"""A tracker's glitch is told from a camera that is fast, rests, turns back or is followed with noise."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from pipeline.frontend.known_poses import front_end
from pipeline.frontend.known_poses.stray_poses import stray_poses

T = np.linspace(0, 1, 120)
FRAMES = 3 * np.arange(120)
PATHS = {
    "straight": np.outer(T, [60, 0, 0]),
    "in and out": np.outer(np.sin(2 * np.pi * T), [0, 30, 0]),
    "at rest but for a dash": np.outer(np.clip(20 * (T - 0.5), 0, 1), [0, 0, 40]),
    "jerks": np.outer(np.round(6 * T), [5, 0, 0]),
    "at rest": np.zeros((120, 3)),
}


def poses(places):
    result = np.tile(np.eye(4), (len(places), 1, 1))
    result[:, :3, 3] = places
    return result


@pytest.mark.parametrize("path", PATHS)
@given(st.floats(1e-3, 1e3), st.floats(0, 0.3), st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_what_a_camera_does_is_not_stray(path, unit, noise, seed):
    shaken = PATHS[path] + noise * np.random.default_rng(seed).normal(size=(len(T), 3))
    assert not stray_poses(poses(unit * shaken), FRAMES)[0].any()


@pytest.mark.parametrize("path", PATHS)
@given(st.integers(5, 112), st.integers(1, 3), st.floats(1e-3, 1e3), st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_a_glitch_is_stray_and_its_neighbours_are_not(path, first, count, unit, seed):
    assume(path != "at rest but for a dash" or not 50 < first < 75)  # beside a dash, its frames may go with the glitch
    places = PATHS[path] + 0.05 * np.random.default_rng(seed).normal(size=(len(T), 3))
    places[first : first + count] += [0, 0, 500]
    stray, away = stray_poses(poses(unit * places), FRAMES)
    assert np.flatnonzero(stray).tolist() == list(range(first, first + count))
    np.testing.assert_allclose(away[first : first + count], 500 * unit, rtol=0.2)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_a_real_excursion_between_gaps_in_time_is_not_stray(count):
    """The frames on the way there and back are blurred, and have no pose."""
    places = np.outer(np.arange(200 + count), [0.1, 0, 0])
    places[100 : 100 + count] += [0, 30, 0]
    frames = np.concatenate([np.arange(100), 120 + np.arange(count), 140 + count + np.arange(100)])
    assert not stray_poses(poses(places), frames)[0].any()


def test_a_camera_that_mostly_rests_goes_both_ways():
    there = np.linspace(0, 30, 12)
    along = np.concatenate([np.zeros(200), there, there[::-1], np.zeros(200)])
    assert not stray_poses(poses(np.outer(along, [1, 0, 0])), np.arange(len(along)))[0].any()


def test_a_model_of_colmap_is_called_by_its_parent_too(tmp_path):
    """Its own name is a number, of which "poses of 0" would say nothing."""
    (tmp_path / "sparse" / "0").mkdir(parents=True)
    assert front_end._called(tmp_path / "sparse" / "0") == "sparse/0"
    assert front_end._called(tmp_path / "sparse" / "poses.txt") == "poses.txt"
