"""What a network with batch normalisation makes of a frame when only the other frames of the batch change."""

from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from completion.data.sampling_training import sample_uniform
from completion.data.shards import Batch, Shard

BATCH = 10
EVERY = 16  # so many judged frames apart are the frames that are looked at
DRAWS = 6  # batches that each judged frame is in


def companion_effect(network: nn.Module, folder: Path, unit_mm: float, points: int) -> dict[str, float] | None:
    """Errors in training mode, that is by the batch's own statistics; None for a network that uses none.

    `abs_rel`: mean relative error over frames and draws. `companions`: mean over pixels of the standard deviation over
    `DRAWS` batches of a pixel's depth, relative to its mean: image, points and weights of the frame are the same in all
    of them, only the other nine frames differ. Both are fractions. The running statistics stay as they are.
    """
    norms = [module for module in network.modules() if type(module) is nn.BatchNorm2d]
    if not norms:
        return None
    shard = Shard.open(folder)
    frames = shard.batch(np.arange(len(shard.images))).to(next(network.parameters()).device)
    depth = frames.depth
    sparse = sample_uniform(depth, points, torch.Generator().manual_seed(0)) / unit_mm
    rng = np.random.default_rng(0)
    chosen = np.arange(0, len(depth), EVERY)
    for norm in norms:
        norm.train()
        norm.momentum = 0.0
    with torch.inference_mode():
        found = torch.stack([unit_mm * _completed(network, frames, sparse, chosen, rng) for _ in range(DRAWS)])
    network.eval()
    truth = depth[chosen]
    known = truth > 0
    error = ((found - truth).abs() / truth.clamp_min(1e-3))[:, known].mean()
    spread = (found.std(dim=0) / found.mean(dim=0).abs().clamp_min(1e-3))[known].mean()
    return {"abs_rel": float(error), "companions": float(spread)}


def _completed(
    network: nn.Module, frames: Batch, sparse: Tensor, chosen: np.ndarray, rng: np.random.Generator
) -> Tensor:
    """Depth (K,1,H,W) of the chosen frames, each in a batch with others at random."""
    depths = []
    for frame in chosen:
        others = rng.choice(np.delete(np.arange(len(sparse)), frame), BATCH - 1, replace=False)
        batch = [int(frame), *others.tolist()]
        lens = None if frames.lens is None else frames.lens[batch]
        depths.append(network(frames.rgb[batch], sparse[batch], lens)[:1].float())
    return torch.cat(depths)
