"""A network's own estimate, given back to it: with it the network looks again.

Where points are few, the first look must carry each of them far and still draw every fold. The second finds the depth
roughly right all over and is left with the detail. It gets the estimate twice: whole, beside the picture, and on a grid
among the points, trusted as far as the first look expected to err, so that normalised convolution starts from it.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from completion.confidence import confidence_from_error
from completion.networks.protocol import Estimate, Grid

Look = Callable[[Tensor, Tensor, Tensor, Estimate | None], Estimate]
MOST_LOOKS = 2  # unless more are asked for: a third gains at most 3 % and costs as much time again


def with_own_points(log_sparse: Tensor, trust: Tensor, last: Estimate, grid: Grid) -> tuple[Tensor, Tensor]:
    """Points and trust (B,1,H,W) -> both with the last look's estimate on a grid among them.

    Measured points stay as they are; own ones are trusted as measured ones of that error would be.
    """
    here = (..., slice(grid.first, None, grid.step), slice(grid.first, None, grid.step))
    measured = trust[here] > 0
    own_trust = confidence_from_error(last.log_error[here].exp())
    all_points, all_trust = log_sparse.clone(), trust.clone()
    all_points[here] = torch.where(measured, log_sparse[here], last.log_depth[here])
    all_trust[here] = torch.where(measured, trust[here], own_trust)
    return all_points, all_trust


def look_again(first: Look, later: Look, picture: Tensor, log_sparse: Tensor, trust: Tensor, looks: int) -> Estimate:
    """`looks` looks, at least one, each after the first with the last one's estimate.

    `first`, `later`: the method `iterate` of a network, or of its copies for the first and for later iterations.
    """
    estimate = first(picture, log_sparse, trust, None)
    for _ in range(looks - 1):
        estimate = later(picture, log_sparse, trust, estimate)
    return estimate
