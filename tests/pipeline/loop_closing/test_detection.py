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


def walk(places: list[int]) -> SimpleNamespace:
    """A submap whose frames each see the forty points of their place, and half of the next one's."""
    seen = [(row, 40 * place + k) for row, place in enumerate(places) for k in range(60)]
    submap = SimpleNamespace(
        frames=np.arange(len(places)),
        points=np.zeros((40 * (max(places, default=0) + 2), 3)),
        observations=np.array(seen, np.int64).reshape(-1, 2),
        world_from_camera=np.broadcast_to(np.eye(4), (len(places), 4, 4)),
    )

    class Part:
        rows = np.arange(len(places))

        def __len__(self):
            return len(places)

    Part.submap = submap
    return Part()


@pytest.mark.parametrize(
    ("places", "expected"),
    [
        ([0] * 12, False),  # all see the same
        ([0, 1, 2, 3, 4], False),  # too few keyframes between any two
        ([0, 1, 2, 3, 4, 5, 6], True),  # the last may be where the first was
        ([], False),
    ],
)
def test_loops_are_looked_for_where_keyframes_far_apart_in_time_share_no_points(places, expected):
    completed = walk(places)
    assert loops.may_have_loops(completed, 60) is expected
    rows = np.arange(len(places))
    words = SimpleNamespace(similarities=lambda one, other: np.ones((len(one), len(other)), np.float32))
    seen = loops.SubmapFeatures(completed, [SimpleNamespace(keyframe=int(row)) for row in rows], None)
    assert bool(loops.loop_candidates(seen, words)) is expected
