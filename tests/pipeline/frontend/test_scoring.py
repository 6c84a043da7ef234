"""Points that a mapper left anywhere: out, with the frames that nothing else holds."""

from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.frontend import scoring
from pipeline.frontend.base import FoundSubmap
from pipeline.frontend.scoring import MIN_SEEN, without_wild_points
from pipeline.mapping.submap import Submap


def submap(errors, frames=5):
    """Every frame sees every point, but the last one those of odd number alone."""
    points = len(errors)
    seen = [(f, p) for f in range(frames) for p in range(points) if f < frames - 1 or p % 2]
    poses = np.tile(np.eye(4), (frames, 1, 1))
    return Submap(
        np.arange(frames) * 10, poses, np.zeros((points, 3)), np.array(errors, float), np.array(seen),
        np.zeros((len(seen), 2)), (100.0, 100.0, 50.0, 50.0),
    )  # fmt: skip


def test_submap_without_such_points_is_the_same_object():
    one = submap([0.4, 3.9] * 10)
    assert without_wild_points(one) is one


@pytest.mark.parametrize("wild", [11.0, 1e150, np.inf, np.nan])
def test_wild_points_go_and_frames_that_saw_little_else(wild):
    rest = without_wild_points(submap([0.4, wild] * 10))
    assert len(rest.points) == 10 >= MIN_SEEN
    assert rest.frames.tolist() == [0, 10, 20, 30]  # the last frame saw the wild ones alone
    assert rest.error_px.max() < 1
    np.testing.assert_array_equal(np.bincount(rest.observations[:, 1]), 4)


def test_nothing_is_left_of_a_model_that_is_wild_throughout():
    assert len(without_wild_points(submap([1e140] * 20)).frames) == 0


@pytest.mark.parametrize(("points", "kept"), [(2, 0), (MIN_SEEN, 1)])
def test_a_model_whose_frames_see_next_to_nothing_is_none(monkeypatch, tmp_path, points, kept):
    monkeypatch.setattr(scoring, "lighting_correlations", lambda *_: np.full(5, np.nan))
    monkeypatch.setattr(scoring, "image_reader", lambda _: None)
    monkeypatch.setattr(scoring, "write_arrays", lambda *_: None)
    whole = submap([0.4] * points)
    found = scoring.candidates_of("global", [FoundSubmap(whole)], SimpleNamespace(log=tmp_path))
    assert len(found) == kept
