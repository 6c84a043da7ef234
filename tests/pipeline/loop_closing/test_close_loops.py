"""The refinement stage on a hand-made submap whose scale creeps: what moves, what is written, what a failure leaves."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from haustra.core.camera import Camera
from haustra.core.errors import ReconstructionError
from haustra.core.progress import SilentProgress
from haustra.core.ray_table import RayTable
from haustra.core.sim3 import scale_of
from pipeline.config import Config, LoopClosingSettings
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.depth_io import DEPTH_STEP, write_confidence, write_depth
from pipeline.depth.keyframe_store import DiskKeyframes
from pipeline.depth.rectification import make_rectifier
from pipeline.input.frames import Frames
from pipeline.loop_closing import close_loops as stage
from pipeline.loop_closing.close_loops import close_loops_stage, load_refined, model_sources
from pipeline.loop_closing.detection import LoopClosure, SubmapFeatures
from pipeline.loop_closing.keyframe_pose_graph import (
    close_loops,
    concatenate,
    covisibility_factors,
    deform,
    merge_by_loops,
)
from pipeline.mapping.submap import Submap
from pipeline.matching.keyframe_features import KeyframeFeatures
from pipeline.matching.sim3_match import Sim3Match
from pipeline.run_folder.workspace import Workspace
from tests.helpers.pose_circle import circle, exponential

CAMERA = Camera("PINHOLE", 64, 64, (40.0, 40.0, 32.0, 32.0))
RAYS = RayTable(CAMERA)
GROWTH = 0.004  # of the scale, from keyframe to keyframe
COUNT = 24
CONFIG = Config(camera="given", loop_closing=LoopClosingSettings(enabled=True))


def drifting_submap(count: int = COUNT, growth: float = GROWTH, seed: int = 0) -> Submap:
    """Two frames a keyframe step on a circle; each point is seen by seven frames, in their drifting scale."""
    rng, true = np.random.default_rng(seed), circle(2 * count)
    nodes = [true[0]]
    for here, there in pairwise(true):
        nodes.append(nodes[-1] @ np.linalg.inv(here) @ there @ exponential(growth / 2 * np.eye(7)[6]))
    nodes = np.stack(nodes)
    points, observations = [], []
    for row in range(0, 2 * count - 6, 2):
        local = np.column_stack([rng.uniform(-0.6, 0.6, (40, 2)), rng.uniform(0.8, 1.3, 40)])
        observations += [(frame, len(points) + k) for frame in range(row, row + 7) for k in range(40)]
        points += list(local @ nodes[row + 3, :3, :3].T + nodes[row + 3, :3, 3])
    poses = nodes.copy()
    poses[:, :3, :3] /= scale_of(nodes)[:, None, None]
    return Submap(
        np.arange(2 * count),
        poses,
        np.array(points),
        np.full(len(points), 0.4),
        np.array(observations),
        np.full((len(observations), 2), 30.0),
        CAMERA.params,
    )


def dense(workspace: Workspace, submap: Submap | None = None) -> CompletedSubmap:
    submap = submap or drifting_submap()
    for folder in (workspace.depth, workspace.confidence):
        folder.mkdir(exist_ok=True, parents=True)
    rows = np.arange(0, len(submap.frames), 2)
    for row in rows:
        write_depth(workspace.depth_path(int(submap.frames[row])), np.ones((64, 64), np.float32))
        write_confidence(workspace.confidence_path(int(submap.frames[row])), np.ones((64, 64)))
    return CompletedSubmap(submap, make_rectifier(CAMERA, 120), rows, DiskKeyframes(workspace))


def seen(completed: CompletedSubmap) -> SubmapFeatures:
    return SubmapFeatures(completed, [KeyframeFeatures.none(int(row)) for row in completed.rows], RAYS)


def closure(first: int, second: int, first_from_second: np.ndarray, sigma: np.ndarray) -> LoopClosure:
    return LoopClosure(Sim3Match(first, second, first_from_second, np.zeros((50, 2), np.int64)), np.diag(sigma**-2.0))


def with_relation(loop: LoopClosure, first_from_second: np.ndarray) -> LoopClosure:
    return replace(loop, match=replace(loop.match, first_from_second=first_from_second))


def true_links(pairs: tuple[tuple[int, int], ...] = ((0, 23), (2, 21), (1, 22))) -> list[LoopClosure]:
    """Between keyframes; what the true circle says, in the scale of either end's own axes."""
    true = circle(2 * COUNT)[::2]
    sigma = np.array([0.01] * 3 + [0.01] * 3 + [0.01])
    found = []
    for first, second in pairs:
        relation = np.linalg.inv(true[first]) @ true[second]
        relation[:3, :3] *= np.exp(-GROWTH * (second - first))  # the second's map is larger: brought to the first's
        relation[:3, 3] *= np.exp(GROWTH * first)
        found.append(closure(first, second, relation, sigma))
    return found


@pytest.fixture
def workspace(tmp_path) -> Workspace:
    made = Workspace(tmp_path)
    made.record |= {"config": CONFIG.model_dump(mode="json")}
    made.finish("structure", mapper="odometry", units=[2.0])
    return made


@pytest.fixture
def frames() -> Frames:
    index = np.arange(2 * COUNT)
    return Frames(index, index / 30, CAMERA, np.full((64, 64), 255, np.uint8), {"used": len(index)})


@pytest.fixture
def seen_twice(monkeypatch):
    """The stage with hand-made links in place of images."""
    monkeypatch.setattr(stage, "find_features", lambda completed, *_: seen(completed))
    monkeypatch.setattr(stage, "loop_candidates", lambda *_: [])
    monkeypatch.setattr(stage, "verify_loops", lambda *_: true_links())
    monkeypatch.setattr(stage, "adjust_loops", lambda _, closed: closed.completed)


def gap(submap: Submap) -> float:
    """Between the end and where the circle says that it is, as seen from the start."""
    true = circle(2 * COUNT)
    return float(np.linalg.norm((submap.centres[46] - submap.centres[0]) - (true[46] - true[0])[:3, 3]))


def test_scale_drift_is_closed_and_everything_follows(workspace):
    completed = dense(workspace)
    closed = close_loops(seen(completed), true_links())
    assert len(closed.accepted_pairs) == 3
    assert gap(completed.submap) > 0.2
    assert gap(closed.completed.submap) < gap(completed.submap) / 5
    assert closed.completed.depth_scale[46] == pytest.approx(np.exp(-GROWTH * 23), abs=0.02)
    depth, _, pose = closed.completed.depth(46)
    np.testing.assert_allclose(depth, closed.completed.depth_scale[46], atol=DEPTH_STEP)
    np.testing.assert_array_equal(pose, closed.completed.submap.world_from_camera[46])


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


def rigid(completed: CompletedSubmap, link: LoopClosure) -> np.ndarray:
    first, second = (
        completed.submap.world_from_camera[completed.rows[k]] for k in (link.match.first, link.match.second)
    )
    return np.linalg.inv(first) @ second


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


def cut(submap: Submap, begin: int, end: int) -> Submap:
    return submap.without_frames({*range(begin), *range(end, 48)})


def test_uniting_keeps_who_saw_what(workspace):
    whole = drifting_submap()
    even, odd = (dense(workspace, whole.without_frames(set(range(k, 48, 2)))) for k in (1, 0))
    followed = np.arange(len(whole.points)) % 2 == 0
    even = replace(even, submap=replace(even.submap, klt=followed))
    both = concatenate(even, odd)
    np.testing.assert_array_equal(both.submap.is_klt, [*followed, *np.zeros_like(followed)])
    assert both.submap.frames.tolist() == list(range(48))
    np.testing.assert_allclose(both.submap.depths().sum(), whole.depths().sum())
    assert set(both.submap.frames[both.rows]) == {*even.submap.frames[even.rows], *odd.submap.frames[odd.rows]}


def test_the_stage_writes_what_it_did_and_resumes_from_it(workspace, frames, seen_twice):
    completed = dense(workspace)
    refined = close_loops_stage(frames, [completed], CONFIG.loop_closing, CONFIG.seed, workspace, SilentProgress())
    record = workspace.result("refinement")
    assert record["submaps"][0]["loops"] == [[0, 46], [4, 42], [2, 44]]
    assert gap(refined[0].submap) < gap(completed.submap) / 5
    again = load_refined([completed], workspace)
    np.testing.assert_array_equal(again[0].submap.world_from_camera, refined[0].submap.world_from_camera)
    np.testing.assert_array_equal(again[0].depth(46)[0], refined[0].depth(46)[0])
    folder, unit = model_sources(workspace)[0]
    assert unit == 1.0
    assert (folder / "images.txt").exists()


def test_a_failing_graph_is_a_warning(workspace, frames, seen_twice, monkeypatch):
    def fail(*_: object) -> None:
        raise ReconstructionError("the pose graph has no solution")

    monkeypatch.setattr(stage, "close_loops", fail)
    completed = dense(workspace)
    assert close_loops_stage(frames, [completed], CONFIG.loop_closing, CONFIG.seed, workspace, SilentProgress()) == [
        completed
    ]
    assert workspace.result("refinement")["warnings"] == [
        "the loops of submap 0 were not closed: the pose graph has no solution"
    ]
    assert model_sources(workspace) == [(workspace.models / "0", 2.0)]


def test_loops_that_no_features_hold_move_nothing(workspace, frames, seen_twice, monkeypatch):
    monkeypatch.setattr(stage, "adjust_loops", lambda *_: None)
    completed = dense(workspace)
    assert close_loops_stage(frames, [completed], CONFIG.loop_closing, CONFIG.seed, workspace, SilentProgress()) == [
        completed
    ]
    record = workspace.result("refinement")
    assert record["submaps"][0]["loops"] == []
    assert record["warnings"] == [f"the loops of submap 0 were not closed: {stage.TOO_FEW_FEATURES}"]


def test_without_the_stage_nothing_changes(workspace, frames):
    completed = dense(workspace)
    off = CONFIG.model_copy(update={"loop_closing": LoopClosingSettings(enabled=False)})
    assert close_loops_stage(frames, [completed], off.loop_closing, off.seed, workspace, SilentProgress()) == [
        completed
    ]
    assert not workspace.is_done("refinement")


def test_the_stage_joins_submaps_and_resumes_from_it(workspace, frames, monkeypatch):
    whole = drifting_submap(growth=0.0)
    parts = [dense(workspace, half) for half in (cut(whole, 0, 28), cut(whole, 20, 48).scaled(1.7))]
    workspace.finish("structure", mapper="odometry", units=[1.0, 1.0])
    relation = np.diag([1 / 1.7] * 3 + [1.0])
    links = [closure(k, m, relation, np.full(7, 0.01)) for k, m in ((10, 0), (12, 2), (13, 3))]
    monkeypatch.setattr(stage, "find_features", lambda completed, *_: seen(completed))
    for name in ("loop_candidates", "merge_candidates"):
        monkeypatch.setattr(stage, name, lambda *_: [])
    monkeypatch.setattr(stage, "verify_loops", lambda one, other, *_: links if one is not other else [])
    refined = close_loops_stage(frames, parts, CONFIG.loop_closing, CONFIG.seed, workspace, SilentProgress())
    assert len(refined) == 1
    assert workspace.result("refinement")["submaps"][0]["members"] == [0, 1]
    again = load_refined(parts, workspace)
    np.testing.assert_array_equal(again[0].submap.frames, refined[0].submap.frames)
    np.testing.assert_array_equal(again[0].rows, refined[0].rows)
    np.testing.assert_allclose(again[0].submap.centres[again[0].submap.frames >= 28], whole.centres[28:], atol=0.01)
    assert len(model_sources(workspace)) == 1


def test_submaps_without_completed_keyframes_pass_through(workspace, frames, seen_twice):
    """What depth could not complete must not end the run, alone or beside a submap that closes its loops."""
    completed = dense(workspace)
    empty = replace(completed, rows=completed.rows[:0])
    refined = close_loops_stage(
        frames, [completed, empty], CONFIG.loop_closing, CONFIG.seed, workspace, SilentProgress()
    )
    assert [len(each) for each in refined] == [len(completed), 0]
    assert refined[0].depth_scale is not None
    assert refined[1].depth_scale is None


@pytest.mark.parametrize("why", ["surface done", "by COLMAP"])
def test_maps_that_must_stay_are_not_touched(workspace, frames, seen_twice, why):
    if why == "surface done":
        workspace.finish("surface", surfaces=[])
    else:
        workspace.finish("structure", mapper="global", units=[2.0])
    completed = dense(workspace)
    assert close_loops_stage(frames, [completed], CONFIG.loop_closing, CONFIG.seed, workspace, SilentProgress()) == [
        completed
    ]
    assert not workspace.is_done("refinement")
