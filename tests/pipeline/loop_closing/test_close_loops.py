"""The refinement stage on a hand-made submap whose scale creeps: what moves, what is written, what a failure leaves."""

from dataclasses import replace

import numpy as np
import pytest

from haustra.core.errors import HaustraError, ReconstructionError
from haustra.core.progress import SilentProgress
from pipeline.config import LoopClosingSettings
from pipeline.frontend.points_stage import points_folder
from pipeline.input.frames import Frames
from pipeline.loop_closing import close_loops as stage
from pipeline.loop_closing.close_loops import close_loops_stage, load_loops_closed, model_sources
from pipeline.run_folder.workspace import Workspace
from tests.helpers.drifting_loop import (
    CAMERA,
    CONFIG,
    COUNT,
    closure,
    cut,
    dense,
    drifting_submap,
    gap,
    seen,
    true_links,
)


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


def test_a_submap_without_keyframes_that_may_close_a_loop_is_not_searched(workspace, frames, monkeypatch):
    monkeypatch.setattr(stage, "may_have_loops", lambda *_: False)
    monkeypatch.setattr(stage, "find_features", lambda *_: pytest.fail("its pictures were read"))
    completed = dense(workspace)
    assert close_loops_stage(frames, [completed], CONFIG.loop_closing, CONFIG.seed, workspace, SilentProgress()) == [
        completed
    ]
    found = workspace.result("refinement")
    entry = {"members": [0], "moved": False, "proposed": 0, "supported": 0, "loops": []}
    assert found == {"submaps": [entry], "warnings": []}


@pytest.fixture
def seen_twice(monkeypatch):
    """The stage with hand-made links in place of images."""
    monkeypatch.setattr(stage, "may_have_loops", lambda *_: True)
    monkeypatch.setattr(stage, "find_features", lambda completed, *_: seen(completed))
    monkeypatch.setattr(stage, "loop_candidates", lambda *_: [])
    monkeypatch.setattr(stage, "verify_loops", lambda *_: true_links())
    monkeypatch.setattr(stage, "adjust_loops", lambda _, closed: closed.completed)


def test_the_stage_writes_what_it_did_and_resumes_from_it(workspace, frames, seen_twice):
    completed = dense(workspace)
    refined = close_loops_stage(frames, [completed], CONFIG.loop_closing, CONFIG.seed, workspace, SilentProgress())
    record = workspace.result("refinement")
    assert record["submaps"][0]["loops"] == [[0, 46], [4, 42], [2, 44]]
    assert gap(refined[0].submap) < gap(completed.submap) / 5
    again = load_loops_closed([completed], workspace)
    np.testing.assert_array_equal(again[0].submap.world_from_camera, refined[0].submap.world_from_camera)
    np.testing.assert_array_equal(again[0].depth(46)[0], refined[0].depth(46)[0])
    folder, unit = model_sources(workspace)[0]
    assert unit == 1.0
    assert (folder / "images.txt").exists()


def test_sparse_models_are_those_with_the_points_that_depth_was_completed_from(workspace):
    assert model_sources(workspace) == [(workspace.models / "0", 2.0)]
    workspace.finish("points", points=[100])
    assert model_sources(workspace) == [(points_folder(workspace) / "0", 1.0)]


def test_a_damaged_file_is_no_failing_graph(workspace, frames, seen_twice, monkeypatch):
    """It can be mended, and the stage must then be made: it is not finished with a warning."""

    def fail(*_: object) -> None:
        raise HaustraError("000012.png is missing or damaged")

    monkeypatch.setattr(stage, "close_loops", fail)
    with pytest.raises(HaustraError, match="missing or damaged"):
        close_loops_stage(frames, [dense(workspace)], CONFIG.loop_closing, CONFIG.seed, workspace, SilentProgress())
    assert not workspace.is_done("refinement")


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
    assert record["warnings"] == [f"the loops of submap 0 were not closed: {stage.NOT_ADJUSTED}"]


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
    again = load_loops_closed(parts, workspace)
    np.testing.assert_array_equal(again[0].submap.frames, refined[0].submap.frames)
    np.testing.assert_array_equal(again[0].rows, refined[0].rows)
    np.testing.assert_allclose(again[0].submap.centres[again[0].submap.frames >= 28], whole.centres[28:], atol=0.01)
    assert len(model_sources(workspace)) == 1


def test_submaps_that_became_the_largest_by_joining_come_first(workspace, frames, monkeypatch):
    whole = drifting_submap(growth=0.0)
    halves = [cut(whole, 0, 28), cut(whole, 20, 48).scaled(1.7)]
    parts = [dense(workspace, part) for part in (cut(whole, 5, 40), *halves)]
    workspace.finish("structure", mapper="odometry", units=[1.0, 1.0, 1.0])
    relation = np.diag([1 / 1.7] * 3 + [1.0])
    links = [closure(k, m, relation, np.full(7, 0.01)) for k, m in ((10, 0), (12, 2), (13, 3))]
    monkeypatch.setattr(stage, "find_features", lambda completed, *_: seen(completed))
    for name in ("loop_candidates", "merge_candidates"):
        monkeypatch.setattr(stage, name, lambda *_: [])

    def verified(one, other, *_):
        return links if one.completed is parts[1] and other.completed is parts[2] else []

    monkeypatch.setattr(stage, "verify_loops", verified)
    refined = close_loops_stage(frames, parts, CONFIG.loop_closing, CONFIG.seed, workspace, SilentProgress())
    assert [record["members"] for record in workspace.result("refinement")["submaps"]] == [[1, 2], [0]]
    assert [len(one.submap.frames) for one in refined] == [56, 35]
    assert stage.first_parts(workspace, 2) == [1, 0]
    assert [len(one.submap.frames) for one in load_loops_closed(parts, workspace)] == [56, 35]
    assert model_sources(workspace)[1] == (workspace.models / "0", 1.0)


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
