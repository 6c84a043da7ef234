"""Keyframes completed in batches, as on a GPU, and one by one, as on a CPU: the same frames are kept and written."""

from functools import partial

import numpy as np
import pytest

from completion.inference.completer import DepthCompleter
from pipeline.depth import completion_stage
from pipeline.depth.keyframe_store import DiskKeyframes
from pipeline.depth.sparse_depth import SparseDepth
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
