"""What a network with batch normalisation makes of a frame when only the other frames of the batch change."""

from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from completion.data.sampling_training import sample_uniform
from completion.data.shards import Shard

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
    rgb, depth, _ = _all_frames(shard)
    sparse = sample_uniform(depth, points, torch.Generator().manual_seed(0))
    rng = np.random.default_rng(0)
    chosen = np.arange(0, len(rgb), EVERY)
    for norm in norms:
        norm.train()
        norm.momentum = 0.0
    with torch.inference_mode():
        found = torch.stack([_completed(network, rgb, sparse, chosen, rng, unit_mm) for _ in range(DRAWS)])
    network.eval()
    truth = depth[chosen]
    known = truth > 0
    error = ((found - truth).abs() / truth.clamp_min(1e-3))[:, known].mean()
    spread = (found.std(dim=0) / found.mean(dim=0).abs().clamp_min(1e-3))[known].mean()
    return {"abs_rel": float(error), "companions": float(spread)}


def _all_frames(shard: Shard) -> tuple[Tensor, Tensor, Tensor | None]:
    batch = shard.batch(np.arange(len(shard.images)))
    return batch.rgb, batch.depth, batch.lens


def _completed(
    network: nn.Module, rgb: Tensor, sparse: Tensor, chosen: np.ndarray, rng: np.random.Generator, unit_mm: float
) -> Tensor:
    """Depth (K,1,H,W) mm of the chosen frames, each in a batch with others at random."""
    depths = []
    for frame in chosen:
        others = rng.choice(np.delete(np.arange(len(rgb)), frame), BATCH - 1, replace=False)
        batch = [int(frame), *others.tolist()]
        depths.append(network(rgb[batch], sparse[batch] / unit_mm, None)[:1].float() * unit_mm)
    return torch.cat(depths)
