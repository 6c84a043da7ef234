"""A network's own estimate, given back to it as further points: with them it looks again.

Where points are few, the first look must carry each of them far and still draw every fold. The second finds the depth
roughly right all over, trusted as far as the first expected to err, and is left with the detail.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from completion.confidence import confidence_from_error

Look = Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor]]
GRID_STEP = 9  # px between own points: some 800 in a picture of 256 px


def with_own_points(
    log_sparse: Tensor,
    trust: Tensor,
    log_depth: Tensor,
    log_error: Tensor,
    step: int = GRID_STEP,
    first: int | None = None,
) -> tuple[Tensor, Tensor]:
    """Points, trust, estimate and its log error, all (B,1,H,W) -> points and trust with the estimate on a grid.

    The grid takes every `step`-th pixel from `first` (half a step) on in both directions. Measured points stay as they
    are; own ones are trusted as measured ones of that error would be.
    """
    first = step // 2 if first is None else first
    grid = torch.zeros_like(trust, dtype=torch.bool)
    grid[..., first::step, first::step] = True
    grid &= trust <= 0
    return torch.where(grid, log_depth, log_sparse), torch.where(grid, confidence_from_error(log_error.exp()), trust)


def look_again(
    first: Look, later: Look, rgb: Tensor, log_sparse: Tensor, trust: Tensor, looks: int
) -> tuple[Tensor, Tensor]:
    """`looks` looks, at least one: each after the first has the last one's estimate among its points.

    `first`, `later`: a `ScaleFreeMSCSANet`, and with `again`, or such networks folded for it.
    """
    log_depth, log_error = first(rgb, log_sparse, trust)
    for _ in range(looks - 1):
        log_depth, log_error = later(rgb, *with_own_points(log_sparse, trust, log_depth, log_error))
    return log_depth, log_error
