"""Loops of a submap of thousands of keyframes: where it is looked at, and what ties it."""

from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.loop_closing import detection as loops
from pipeline.loop_closing.keyframe_pose_graph import MIN_COVISIBLE, REACH, _covisible_pairs


@pytest.mark.parametrize("count", [1, 59, 61, 480, 481, 2000])
def test_places_lie_near_enough_to_support_each_other(monkeypatch, count):
    monkeypatch.setattr(loops, "SparseDepthMaker", lambda *_: None)
    monkeypatch.setattr(loops, "ray_table", lambda *_: None)
    monkeypatch.setattr(loops, "_lifted", lambda completed, maker, rays, row: row)
    workspace = SimpleNamespace(config=SimpleNamespace(sparse=None))

    class Part:
        rows = np.arange(count) * 3
        submap = camera = None

        def __len__(self):
            return count

    Part.workspace = workspace
    found = loops.find_features(Part(), 60).features
    assert found[0] == 0
    assert np.diff(np.append(found, 3 * count)).max() / 3 < REACH
    assert len(found) <= 60 or count > 480


def test_keyframes_that_share_enough_or_follow_each_other_are_tied():
    rng = np.random.default_rng(0)
    seen = [np.flatnonzero(rng.random(400) < share) for share in rng.uniform(0.05, 0.5, 30)]
    seen[7] = seen[7][:0]
    expected = [
        (one, other)
        for one in range(30)
        for other in range(one + 1, 30)
        if other == one + 1 or len(np.intersect1d(seen[one], seen[other])) >= MIN_COVISIBLE
    ]
    assert 29 < len(expected) < 400
    assert _covisible_pairs(seen, 400) == expected


def test_points_that_two_places_share_are_counted_once():
    """A point that a frame observed twice is one point."""
    rng = np.random.default_rng(1)
    observations = rng.integers(0, [12, 50], (300, 2))
    submap = SimpleNamespace(points=np.zeros((50, 3)), frames=np.arange(12), observations=observations)
    rows = [1, 4, 9]
    sets = [set(observations[observations[:, 0] == row, 1].tolist()) for row in rows]
    expected = [[len(one & other) for other in sets] for one in sets]
    np.testing.assert_array_equal(loops._shared(SimpleNamespace(submap=submap), rows), expected)
