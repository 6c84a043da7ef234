"""What a network must offer so that `haustra train`, `haustra evaluate` and `reconstruct` use it on points without a
unit. A class that offers it needs its own file and a row in `completion.networks.registry`, nothing else."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, runtime_checkable

import torch
from torch import Tensor, nn


class Estimate(NamedTuple):
    """Log depth and log relative error, both (B,1,H,W): log(depth / median of the sparse points), and log of the scale
    of the error's Laplace distribution."""

    log_depth: Tensor
    log_error: Tensor


class SampleGrid(NamedTuple):
    """Every `step`-th row and column of pixels from `first` on, 0 <= first < step."""

    step: int
    first: int


GRID = SampleGrid(9, 4)  # px: some 800 samples of an image of 256 px


@runtime_checkable
class DepthNetwork(Protocol):
    """Scale-invariant depth completion: image and log sparse depth to an `Estimate`, once or iteratively.

    The class is an `nn.Module`. `config` is a dataclass, saved in the header of weight files; its field `iterations`,
    where it has one, is the greatest number that the network was trained for, else that is 1.
    """

    config: Any
    precisions: tuple[str, ...]  # number formats that `for_device` knows, of int8, bf16 and fp32; the last always works
    stride: int  # px; sides of images that the network is exported for are multiples of it

    def prepare(self, rgb: Tensor) -> Tensor:
        """Image (B,3,H,W), uint8 or float in [0,1] -> what `iterate` takes of it, once for all iterations."""

    def iterate(
        self, image: Tensor, log_sparse: Tensor, trust: Tensor, last: Estimate | None = None, grid: SampleGrid = GRID
    ) -> Estimate:
        """One iteration. image: of `prepare`; log_sparse (B,1,H,W) = log(depth / median), 0 where there is no point;
        trust (B,1,H,W) in [0,1], 0 = no point; last: the iteration before's estimate, None in the first.

        grid: pixels at which `last` may join the points; training draws one for each iteration.
        """

    def folded(self, recurrent: bool) -> nn.Module:
        """An evaluation copy of the first iteration or (`recurrent`) of later ones, for the ONNX exporter: called with
        rgb (B,3,H,W) in [0,1], log_sparse, trust and, if `recurrent`, the last estimate."""

    def for_device(self, device: torch.device, precision: str, recurrent: bool) -> DepthNetwork:
        """The fastest evaluation copy on a device in one of `precisions`; `self` stays as it is."""


def most_iterations(config: Any) -> int:
    """Iterations that a network of this configuration was trained for, at most."""
    return getattr(config, "iterations", 1)
