"""Which frames a batch has."""

import numpy as np
import pytest
import torch

from completion.data.shards import Shard
from completion.training.batches import draw_batch, shards_of_one_size
from completion.training.config import make_config
from completion.training.distributed import ProcessGroup

CPU = torch.device("cpu")


def shard(value, size=8, lens=True):
    """Sixty frames whose depth is `value` plus a 64th for each frame."""
    depths = (value + np.arange(60)[:, None, None] / 64 * np.ones((60, size, size))).astype(np.float16)
    images = np.full((60, size, size, 3), value, np.uint8)
    return Shard(images, depths, np.repeat(np.arange(20), 3), np.full((60, 4), value, np.float32) if lens else None)


def batches(shards, steps=40, **changes):
    config = make_config("paper", shards=(), out="w", **changes)
    splits = [one.split()[0] for one in shards]
    return [draw_batch(config, step, shards, splits, ProcessGroup(), CPU)[0] for step in range(steps)]


def test_a_batch_has_frames_of_all_shards_of_one_size_each_with_its_own_depth_and_lens():
    drawn = batches([shard(10), shard(20), shard(30)])
    scenes = torch.stack([batch.depth.mean((1, 2, 3)).floor() for batch in drawn])
    assert all(len(set(of.tolist())) >= 2 for of in scenes)
    assert torch.bincount(scenes.flatten().long(), minlength=31)[[10, 20, 30]].min() > 100
    for batch in drawn:
        assert torch.equal(batch.lens[:, 0], batch.depth[:, 0, 0, 0].floor())
        assert torch.allclose(batch.rgb[:, 0, 0, 0] * 255, batch.lens[:, 0])
        assert len(set(batch.depth[:, 0, 0, 0].tolist())) == 10  # no frame twice
    without = batches([shard(10), shard(20, lens=False)], steps=3)
    assert all(batch.lens is None for batch in without)


def test_frames_of_two_sizes_do_not_share_a_batch_nor_do_shards_that_are_kept_apart():
    several = [shard(10), shard(20, size=12), shard(30)]
    assert shards_of_one_size(several) == [[0, 2], [1]]
    sizes = {batch.rgb.shape[2] for batch in batches(several)}
    assert sizes == {8, 12}
    apart = batches([shard(10), shard(20)], mix_shards=False)
    assert all(len(batch.depth.floor().unique()) == 1 for batch in apart)


def test_a_single_shard_is_drawn_from_as_when_shards_are_kept_apart():
    both = [batches([shard(10)], steps=5, mix_shards=mixed) for mixed in (True, False)]
    assert all(torch.equal(a.depth, b.depth) for a, b in zip(*both, strict=True))


@pytest.mark.parametrize("rank", [0, 1])
def test_processes_share_a_batch(rank):
    config, one = make_config("paper", shards=(), out="w"), shard(10)
    whole = draw_batch(config, 3, [one], [one.split()[0]], ProcessGroup(), CPU)[0].depth
    part = draw_batch(config, 3, [one], [one.split()[0]], ProcessGroup(rank, 2), CPU)[0].depth
    assert set(part[:, 0, 0, 0].tolist()) < set(whole[:, 0, 0, 0].tolist())
    assert len(part) == 5


def test_in_passes_every_frame_comes_once_before_one_comes_again():
    one = shard(10)
    frames = [batch.depth[:, 0, 0, 0] for batch in batches([one], steps=10, passes=True)]
    count = len(one.split()[0]) // 10  # batches of a pass
    passes = [torch.cat(frames[first : first + count]) for first in (0, count)]
    assert all(len(of.unique()) == 10 * count for of in passes)
    assert not torch.equal(*passes)


def test_where_numbers_are_drawn_changes_nothing_on_a_cpu():
    for augmentation in (False, True):
        shards = [shard(10), shard(20)]
        one, other = (batches(shards, 4, draw_on=where, augmentation=augmentation) for where in ("cpu", "device"))
        assert all(torch.equal(a.rgb, b.rgb) and torch.equal(a.depth, b.depth) for a, b in zip(one, other, strict=True))
