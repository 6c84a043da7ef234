"""A network's own estimate, given back to it: with it the network looks again.

Where points are few, the first look must carry each of them far and still draw every fold. The second finds the depth
roughly right all over and is left with the detail. It gets the estimate twice: whole, beside the picture, and on a grid
among the points, trusted as far as the first look expected to err, so that normalised convolution starts from it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from completion.confidence import confidence_from_error


class Estimate(NamedTuple):
    """What a look makes of a frame: log(depth / median of the points) and log of its expected error, (B,1,H,W)."""

    log_depth: Tensor
    log_error: Tensor


class Grid(NamedTuple):
    """Every `step`-th row and column from `first` on, which is less than `step`."""

    step: int
    first: int


Look = Callable[[Tensor, Tensor, Tensor, Estimate | None], Estimate]
MOST_LOOKS = 2  # unless more are asked for: a third gains at most 3 % and costs as much time again
GRID = Grid(9, 4)  # of own points, px: some 800 in a picture of 256 px


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

    `first`, `later`: a `ScaleFreeMSCSANet`'s `look`, or that of the network folded for the one and the other.
    """
    estimate = first(picture, log_sparse, trust, None)
    for _ in range(looks - 1):
        estimate = later(picture, log_sparse, trust, estimate)
    return estimate
