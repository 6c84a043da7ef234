"""Keyframes completed in batches, as on a GPU, and one by one, as on a CPU: the same frames are kept and written."""

import shutil
from contextlib import nullcontext
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from completion.inference.completer import DepthCompleter
from haustra.core.progress import SilentProgress
from pipeline.config import DepthSettings
from pipeline.depth import completion_stage
from pipeline.depth.completion_stage import complete_depth
from pipeline.depth.depth_io import read_depth
from pipeline.depth.keyframe_store import DiskKeyframes
from pipeline.depth.sparse_depth import SparseDepth, SparseDepthMaker
from tests.helpers.tiny_run import SIDE, make_tiny_run

FEW = 3  # a row with too few points


def points_of(row: int) -> SparseDepth:
    rng = np.random.default_rng(row)
    count = completion_stage.MIN_POINTS - 1 if row == FEW else 40
    return SparseDepth(rng.uniform(1, SIDE - 1, (count, 2)), rng.uniform(0.8, 1.2, count), np.full(count, 0.01))


@pytest.mark.parametrize("size", [2, 5, 8])
def test_a_batch_gives_what_its_frames_give_alone(tmp_path, size: int) -> None:
    completer = DepthCompleter.load("mscsa", precision="fp32")
    results = {}
    for name, step in (("alone", 1), ("batches", size)):
        run = make_tiny_run(tmp_path / name, first=24, second=8)
        submap, store = run.completed[0], DiskKeyframes(run.workspace)
        rows = submap.rows[:8].tolist()
        for row in rows:
            run.workspace.depth_path(int(submap.submap.frames[row])).unlink(missing_ok=True)
        content = np.full((SIDE, SIDE), 255, np.uint8)
        complete = partial(completion_stage._complete, submap, points=points_of, content=content)
        whole = []
        for start in range(0, len(rows), step):
            whole += complete(rows[start : start + step], completer=completer, store=store)
        kept = [row for row, enough in whole if enough]
        assert kept == [row for row in rows if row != FEW]
        results[name] = [store.depth(int(submap.submap.frames[row])) for row in kept]
    for one, other in zip(results["alone"], results["batches"], strict=True):
        np.testing.assert_allclose(one, other, rtol=2e-3)  # two steps of the depth on disk


class Constant:
    """Stands for a `DepthCompleter`: depth is 1 everywhere."""

    at_once = batch_size = 1
    working_side_by_side = nullcontext

    def batch(self, rgb, sparse, error, corrected):
        return np.ones_like(sparse), np.full_like(sparse, 0.5)


@pytest.mark.parametrize("photometric", [True, False])
def test_depth_of_a_stopped_run_is_kept_only_where_no_pass_follows(tmp_path, photometric: bool) -> None:
    """What lies among the final depths then is of a version without the second pass, and was not refined."""
    run = make_tiny_run(tmp_path / "run", first=24, second=8)
    workspace, submaps = run.workspace, [one.submap for one in run.completed]
    workspace.record["stages"].pop(completion_stage.STAGE, None)
    settings = DepthSettings(photometric=photometric, keyframe_motion=1e-3)
    complete_depth(run.frames, submaps, Constant, settings, workspace, SilentProgress())
    made = workspace.first_depth if photometric else workspace.depth
    assert len(list(made.glob("*[0-9].png"))) > 8
    assert workspace.depth.exists() != photometric
    values = {float(np.median(read_depth(path))) for path in made.glob("*[0-9].png") if "confidence" not in path.name}
    assert (values == {1.0}) == photometric


@pytest.mark.parametrize(("gives", "at_once"), [("gathered", True), ("none", False)])
def test_where_a_sensor_gives_points_depth_is_corrected_when_it_is_completed(tmp_path, monkeypatch, gives, at_once):
    """And what an earlier version left to be refined is made anew."""
    corrected = []

    class Recorder(Constant):
        def batch(self, rgb, sparse, error, corrected_too):
            corrected.append(corrected_too)
            return super().batch(rgb, sparse, error, corrected_too)

    sensor = SimpleNamespace(settings=SimpleNamespace(points=gives))
    monkeypatch.setattr(completion_stage, "open_sensor", lambda *_: sensor)
    monkeypatch.setattr(
        completion_stage, "points_of", lambda one, *_: SparseDepthMaker(one.submap, one.camera).sparse_depth
    )
    run = make_tiny_run(tmp_path / "run", first=24, second=8)
    workspace, submaps = run.workspace, [one.submap for one in run.completed]
    workspace.record["stages"].pop(completion_stage.STAGE, None)
    workspace.first_depth.mkdir()
    (workspace.first_depth / "000000.png").write_bytes(b"half of a picture")
    shutil.rmtree(workspace.depth)
    settings = DepthSettings(keyframe_motion=1e-3)
    found = complete_depth(run.frames, submaps, Recorder, settings, workspace, SilentProgress())
    assert corrected
    assert set(corrected) == {at_once}
    assert workspace.first_depth.exists() != at_once
    assert all((one.depth(int(row))[0] == 1).all() for one in found for row in one.rows[-2:])
