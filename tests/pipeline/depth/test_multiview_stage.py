"""Depth from several views on a tube of known depth: what is carried over, what is written, what a stop leaves."""

from __future__ import annotations

import shutil
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from completion.confidence import error_from_confidence
from completion.inference.completer import DepthCompleter
from completion.inference.kriging import towards_points
from haustra.core.progress import SilentProgress
from pipeline.config import DepthSettings
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.keyframe_store import DiskKeyframes, depth_on_disk
from pipeline.depth.multiview_stage import STAGE, refine_depth
from pipeline.depth.sparse_depth import SparseDepth, SparseDepthMaker
from pipeline.run_folder.workspace import Workspace
from tests.helpers.tiny_run import make_tiny_run

ON = DepthSettings(multiview=True, photometric=False)
FRAMES = SimpleNamespace(camera=SimpleNamespace(width=64))


class Recorder:
    """Stands for a `DepthCompleter`: returns twice the depth and keeps what it was given."""

    can_refine, at_once = True, 1
    working_side_by_side = nullcontext

    def __init__(self) -> None:
        self.calls: list[dict[str, np.ndarray]] = []

    def refine(self, rgb, sparse, error, depth, confidence):
        self.calls.append({"sparse": sparse, "error": error, "depth": depth, "confidence": confidence})
        return 2 * depth, np.full_like(confidence, 0.5)


@pytest.fixture
def completed(tmp_path: Path) -> tuple[CompletedSubmap, Workspace]:
    """A submap whose first depths are on disk, and none that is refined."""
    tiny = make_tiny_run(tmp_path / "run")
    workspace, one = tiny.workspace, tiny.completed[0]
    workspace.record["stages"].pop("multiview", None)
    first = DiskKeyframes(workspace, first=True)
    for row in map(int, one.rows):
        index = int(one.submap.frames[row])
        first.write_depth(index, one.store.depth(index), one.store.confidence(index))
        workspace.depth_path(index).unlink()
        workspace.confidence_path(index).unlink()
    return CompletedSubmap(one.submap, one.rectifier, one.rows, depth_on_disk(workspace)), workspace


def unwanted() -> DepthCompleter:
    raise AssertionError("nothing is to be refined")


def refined(submap: CompletedSubmap, workspace: Workspace, completer: Recorder) -> CompletedSubmap:
    return refine_depth(FRAMES, [submap], lambda: completer, ON, workspace, SilentProgress())[0]


def test_every_keyframe_is_refined_from_first_depths_and_the_first_ones_go(completed) -> None:
    submap, workspace = completed
    before = {int(row): submap.depth(int(row))[0] for row in submap.rows}
    recorder = Recorder()
    after = refined(submap, workspace, recorder)
    assert len(recorder.calls) == len(submap)
    for row, call in zip(map(int, submap.rows), recorder.calls, strict=True):
        np.testing.assert_array_equal(call["depth"], before[row])  # never a neighbour's or an own refined one
        np.testing.assert_allclose(after.depth(row)[0], 2 * before[row], atol=1e-3)
    assert not workspace.first_depth.exists()
    assert not depth_on_disk(workspace).first


def test_points_of_the_neighbours_lie_on_the_wall_that_they_saw_and_leave_measured_ones_alone(
    completed,
) -> None:
    submap, workspace = completed
    recorder = Recorder()
    refined(submap, workspace, recorder)
    call = recorder.calls[len(recorder.calls) // 2]
    row = int(submap.rows[len(recorder.calls) // 2])
    own, _ = SparseDepthMaker(submap.submap, submap.camera).sparse_depth(row).maps(*call["sparse"].shape)
    np.testing.assert_array_equal(call["sparse"][own > 0], own[own > 0])
    carried = (call["sparse"] > 0) & (own == 0)
    assert carried.sum() > 20
    assert (call["error"][carried] > 0).all()


def test_the_points_are_those_of_the_first_depth_a_sensors_too(completed, monkeypatch) -> None:
    submap, workspace = completed
    sensed = SparseDepth(np.array([[10.5, 20.5], [30.5, 12.5]]), np.array([1.25, 0.75]), np.array([0.01, 0.02]))
    monkeypatch.setattr("pipeline.depth.multiview_stage.points_of", lambda *_: lambda _: sensed)
    recorder = Recorder()
    refined(submap, workspace, recorder)
    assert len(recorder.calls) == len(submap)
    for call in recorder.calls:
        assert (call["sparse"][20, 10], call["sparse"][12, 30]) == (1.25, 0.75)
        assert call["error"][[20, 12], [10, 30]] == pytest.approx([0.01, 0.02])


def test_a_run_that_was_stopped_goes_on_to_the_same_bytes(completed) -> None:
    submap, workspace = completed

    class Stops(Recorder):
        def refine(self, *arrays):
            if len(self.calls) == 5:
                raise KeyboardInterrupt
            return super().refine(*arrays)

    stopped = Stops()
    with pytest.raises(KeyboardInterrupt):
        refined(submap, workspace, stopped)
    going_on = Recorder()
    again = CompletedSubmap(submap.submap, submap.rectifier, submap.rows, depth_on_disk(workspace))
    refined(again, workspace, going_on)
    assert len(stopped.calls) + len(going_on.calls) == len(submap)
    assert not workspace.first_depth.exists()


def test_first_depth_of_a_network_of_one_iteration_is_corrected_by_its_points_alone(completed) -> None:
    submap, workspace = completed
    before = {int(row): submap.depth(int(row)) for row in submap.rows}
    plain = Recorder()
    plain.can_refine = False
    after, points = refined(submap, workspace, plain), SparseDepthMaker(submap.submap, submap.camera)
    assert not plain.calls
    for row, (depth, confidence, _) in before.items():
        own = points.sparse_depth(row).maps(*depth.shape)
        expected = towards_points(depth, error_from_confidence(confidence, 1 / 510), *own)
        np.testing.assert_allclose(after.depth(row)[0], expected, atol=2 * 4e-4)  # steps of the depth on disk
        np.testing.assert_array_equal(after.depth(row)[1], confidence)


def test_refined_depth_is_corrected_by_the_keyframes_own_points(completed, monkeypatch) -> None:
    """Of a network that makes all of it 1 % too far."""
    submap, workspace = completed
    before = {int(row): submap.depth(int(row))[0] for row in submap.rows}

    def points(row: int) -> SparseDepth:
        y, x = (pixels[::4] for pixels in np.nonzero(before[row]))
        return SparseDepth(np.column_stack([x, y]) + 0.5, before[row][y, x].astype(float), np.full(len(x), 0.004))

    class Far(Recorder):
        def refine(self, rgb, sparse, error, depth, confidence):
            return 1.01 * depth, confidence

    monkeypatch.setattr("pipeline.depth.multiview_stage.points_of", lambda *_: points)
    after = refined(submap, workspace, Far())
    for row, depth in before.items():
        off = after.depth(row)[0][depth > 0] / depth[depth > 0]
        assert np.median(off) == pytest.approx(1, abs=0.002)


def test_without_first_depths_nothing_is_done(completed) -> None:
    """The completion stage leaves none where there is no second pass."""
    submap, workspace = completed
    shutil.rmtree(workspace.first_depth)
    assert refine_depth(FRAMES, [submap], unwanted, ON, workspace, SilentProgress()) == [submap]
    assert not workspace.is_done(STAGE)
