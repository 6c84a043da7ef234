"""The pose graph of a submap, on one whose drift is known."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.depth.depth_io import DEPTH_STEP
from pipeline.loop_closing.keyframe_pose_graph import (
    close_loops,
    concatenate,
    covisibility_factors,
    deform,
    merge_by_loops,
)
from pipeline.run_folder.workspace import Workspace
from tests.helpers.drifting_loop import (
    CAMERA,
    CONFIG,
    GROWTH,
    closure,
    cut,
    dense,
    drifting_submap,
    gap,
    rigid,
    seen,
    true_links,
    with_relation,
)
from tests.helpers.pose_circle import exponential


@pytest.fixture
def workspace(tmp_path) -> Workspace:
    made = Workspace(tmp_path)
    made.record |= {"config": CONFIG.model_dump(mode="json")}
    made.finish("structure", mapper="odometry", units=[2.0])
    return made


def test_scale_drift_is_closed_and_everything_follows(workspace):
    completed = dense(workspace)
    closed = close_loops(seen(completed), true_links())
    assert len(closed.accepted_pairs) == 3
    assert gap(completed.submap) > 0.2
    assert gap(closed.completed.submap) < gap(completed.submap) / 5
    assert closed.completed.depth_scale[46] == pytest.approx(np.exp(-GROWTH * 23), abs=0.02)
    depth, _, world_from_camera = closed.completed.depth(46)
    np.testing.assert_allclose(depth, closed.completed.depth_scale[46], atol=DEPTH_STEP)
    np.testing.assert_array_equal(world_from_camera, closed.completed.submap.world_from_camera[46])


def test_moving_keeps_each_point_where_its_nearest_frame_saw_it(workspace):
    completed = dense(workspace)
    nodes = completed.submap.world_from_camera[completed.rows] @ exponential(np.array([0.1, 0, 0.2, 0.3, 0, 0, 0.2]))
    after = deform(completed, completed.rows, nodes)
    before, now = completed.submap, after.submap
    np.testing.assert_allclose(np.linalg.det(now.world_from_camera[:, :3, :3]), 1)
    np.testing.assert_allclose(after.depth_scale[completed.rows], np.exp(0.2))
    for point in range(0, len(before.points), 37):
        mine = before.observations[before.observations[:, 1] == point, 0]
        nearest = mine[np.linalg.norm(before.centres[mine] - before.points[point], axis=1).argmin()]
        seen = before.points_in_camera(nearest, before.points[[point]])
        expected = after.depth_scale[nearest] * seen
        np.testing.assert_allclose(now.points_in_camera(nearest, now.points[[point]]), expected, atol=1e-9)


def test_ties_know_the_scale_better_between_near_keyframes(workspace):
    odometry_factors = {(factor.first, factor.second): factor for factor in covisibility_factors(dense(workspace))}
    near, far = (np.linalg.inv(odometry_factors[pair].information)[6, 6] for pair in ((5, 6), (5, 8)))
    assert 0 < near < far < 0.05
    assert (0, 1) in odometry_factors
    assert (0, 20) not in odometry_factors


def test_a_map_that_fulfils_its_loops_is_left_alone(workspace):
    completed = dense(workspace, drifting_submap(growth=0.0))
    exact = [with_relation(k, rigid(completed, k)) for k in true_links()]
    closed = close_loops(seen(completed), exact)
    assert closed.completed is completed
    assert closed.consistent == 3
    assert closed.accepted_pairs == ()


def test_what_little_a_map_misses_its_loops_by_is_left_to_the_images(workspace):
    completed = dense(workspace, drifting_submap(growth=0.0))
    off = np.eye(4)
    off[0, 3] = 0.015  # of sigma 0.01: a squared misfit of 2.25
    links = [with_relation(k, off @ rigid(completed, k)) for k in true_links()]
    closed = close_loops(seen(completed), links)
    assert closed.completed is completed
    assert closed.accepted == tuple(links)
    assert closed.accepted_pairs == ((0, 46), (4, 42), (2, 44))
    wild = off.copy()
    wild[0, 3] = 0.3
    false = [with_relation(k, wild @ k.match.first_from_second) for k in true_links(((5, 20), (6, 19)))]
    assert close_loops(seen(completed), [*links, *false]).accepted == tuple(links)


def test_a_single_false_link_changes_nothing(workspace):
    completed = dense(workspace)
    lie = closure(3, 15, np.eye(4), np.full(7, 0.01))
    assert close_loops(seen(completed), [lie]).completed is completed


def test_halves_of_different_scale_are_joined(workspace):
    """One circle cut in two, the second at 1.7 times the scale; links between frames that both halves have."""
    whole = drifting_submap(growth=0.0)
    first, second = (dense(workspace, half) for half in (cut(whole, 0, 28), cut(whole, 20, 48).scaled(1.7)))
    links = []
    for k, m in ((10, 0), (12, 2), (13, 3)):
        relation = np.diag([1 / 1.7] * 3 + [1.0])
        links.append(closure(k, m, relation, np.full(7, 0.01)))
    joined = merge_by_loops((seen(first), seen(second)), links)
    assert joined is not None
    assert len(joined.submap.frames) == len(first.submap.frames) + len(second.submap.frames)
    assert (np.diff(joined.submap.frames) >= 0).all()
    latest = np.flatnonzero(joined.submap.frames >= 28)
    np.testing.assert_allclose(joined.submap.centres[latest], whole.centres[28:], atol=0.01)
    np.testing.assert_allclose(joined.depth_scale[latest], 1 / 1.7, rtol=0.01)
    assert merge_by_loops((seen(first), seen(second)), links[:1]) is None
    lens = replace(second, submap=replace(second.submap, camera_params=(41.0, *CAMERA.params[1:])))
    assert merge_by_loops((seen(first), seen(lens)), links) is None


def test_uniting_keeps_who_saw_what(workspace):
    whole = drifting_submap()
    even, odd = (dense(workspace, whole.without_frames(set(range(k, 48, 2)))) for k in (1, 0))
    followed = np.arange(len(whole.points)) % 2 == 0
    refined = np.where(followed, 0.02, np.nan)
    even = replace(even, submap=replace(even.submap, klt=followed, depth_error=refined))
    both = concatenate(even, odd)
    np.testing.assert_array_equal(both.submap.is_klt, [*followed, *np.zeros_like(followed)])
    np.testing.assert_array_equal(both.submap.depth_error, [*refined, *np.full(len(refined), np.nan)])
    kept = both.submap.without_points(np.arange(len(both.submap.points)) % 4 == 1)
    assert np.isfinite(kept.depth_error).sum() == followed.sum()  # of which none was left out
    assert both.submap.frames.tolist() == list(range(48))
    np.testing.assert_allclose(both.submap.depths().sum(), whole.depths().sum())
    assert set(both.submap.frames[both.rows]) == {*even.submap.frames[even.rows], *odd.submap.frames[odd.rows]}
