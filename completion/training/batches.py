"""The batch of a training step: which frames of which shards."""

import numpy as np
import torch
from numpy.typing import NDArray

from completion.data.draws import DeviceGenerator
from completion.data.shards import Batch, Shard, augment, joined
from completion.training.config import TrainConfig
from completion.training.distributed import ProcessGroup


def draw_batch(
    config: TrainConfig,
    step: int,
    shards: list[Shard],
    splits: list[NDArray[np.int64]],
    processes: ProcessGroup,
    device: torch.device,
) -> tuple[Batch, torch.Generator]:
    """This process's part of a step's batch from the training frames `splits`, and its generator in that step: so a
    resumed run draws what an unbroken one would.

    The order depends on the seed and the shards alone: every network of a comparison sees the same. A batch has frames
    of all shards of one size, so that statistics of a batch are those of all scenes.
    """
    rng = np.random.default_rng((config.seed, step))
    where = device if config.draw_on == "device" else torch.device("cpu")
    seed = int(rng.integers(2**62)) + processes.rank
    generator = torch.Generator().manual_seed(seed) if where.type == "cpu" else DeviceGenerator.seeded(where, seed)
    groups = shards_of_one_size(shards) if config.mix_shards else [[number] for number in range(len(shards))]
    share = np.array([sum(len(splits[number]) for number in group) for group in groups])
    group = groups[rng.choice(len(groups), p=share / share.sum())]
    frames = np.concatenate([splits[number] for number in group])
    of_shard = np.repeat(group, [len(splits[number]) for number in group])
    if config.passes:
        drawn = next_of_pass(len(frames), config, step)
    else:
        drawn = rng.choice(len(frames), config.batch, replace=False)
    own = drawn[processes.rank :: processes.size]
    held_on = where if config.augmentation else device
    parts = [shards[n].batch(frames[own[of_shard[own] == n]], held_on) for n in group if (of_shard[own] == n).any()]
    batch = parts[0] if len(parts) == 1 else joined(parts)
    return (augment(batch, generator) if config.augmentation else batch).to(device), generator


def next_of_pass(frames: int, config: TrainConfig, step: int) -> NDArray[np.int64]:
    """The step's frames where a pass over all of them ends before the next begins; what does not fill a batch at its
    end is left out."""
    batches = frames // config.batch
    order = np.random.default_rng((config.seed, step // batches)).permutation(frames)
    return order[step % batches * config.batch :][: config.batch]


def shards_of_one_size(shards: list[Shard]) -> list[list[int]]:
    """Numbers of the shards whose frames can share a batch."""
    groups: dict[tuple[int, ...], list[int]] = {}
    for number, shard in enumerate(shards):
        groups.setdefault(shard.images.shape[1:], []).append(number)
    return list(groups.values())
