"""What is trained: ours on points as structure from motion gives them, or the paper's setting for any network.

Both take a batch of images and true depths in millimetres, draw the points, and give a loss and a validation error.
"""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor, nn

from completion.data.sampling_training import SfmPattern, normalise_log, sample_like_sfm, sample_uniform
from completion.networks.mscsa_sfm import ScaleFreeConfig, ScaleFreeMSCSANet, picture_inputs
from completion.networks.recurrence import MOST_LOOKS, Estimate, Grid, look_again
from completion.networks.registry import build_model
from completion.training.config import TrainConfig
from completion.training.losses import completion_loss, masked_l1

GRID_STEPS = (6, 17)  # px, from and below: of the grids of own points that training draws


class Task(Protocol):
    """One way of training; `network` is what a checkpoint holds."""

    network: nn.Module

    def loss(self, rgb: Tensor, depth: Tensor, lens: Tensor | None, generator: torch.Generator) -> Tensor:
        """Scalar loss of rgb (B,3,H,W) in [0,1], depth (B,1,H,W) mm with 0 = none, lens (B,4) fx fy cx cy px."""

    def predict(
        self, network: nn.Module, rgb: Tensor, depth: Tensor, lens: Tensor | None, generator: torch.Generator
    ) -> Tensor:
        """Completed depth (B,1,H,W) mm from points that validation draws of the true depth."""


class ScaleFreeTask:
    """Median-normalised log depth from random SfM-like patterns."""

    def __init__(self, config: TrainConfig) -> None:
        self.config = config
        size = ScaleFreeConfig(width=config.width, anchor=config.anchor, looks=config.looks)
        self.network: nn.Module = ScaleFreeMSCSANet(size)

    def loss(self, rgb: Tensor, depth: Tensor, lens: Tensor | None, generator: torch.Generator) -> Tensor:
        sparse, trust = sample_like_sfm(rgb, depth, SfmPattern(), generator)
        log_sparse, median = normalise_log(sparse)
        valid = (depth > 0) & (depth < self.config.max_depth_mm)
        target = torch.log(depth.clamp_min(1e-3) / median).clamp(-3.9, 3.9)
        with torch.autocast(rgb.device.type, torch.bfloat16, enabled=self.config.bf16):
            last, grid = self._earlier_looks(rgb, log_sparse, trust, generator)
            log_depth, log_error = self.network(rgb, log_sparse, trust, last, grid)
        return completion_loss(log_depth, log_error, target, valid)

    def _earlier_looks(
        self, rgb: Tensor, log_sparse: Tensor, trust: Tensor, generator: torch.Generator
    ) -> tuple[Estimate | None, Grid]:
        """The estimate after 0 to `looks` - 1 looks (None after 0), without gradients, and the grid of the next."""
        last = None
        earlier = int(torch.randint(self.config.looks, (), generator=generator))
        for _ in range(earlier):
            with torch.no_grad():
                last = self.network(rgb, log_sparse, trust, last, _draw_grid(generator))
        return last, _draw_grid(generator)

    def predict(
        self, network: nn.Module, rgb: Tensor, depth: Tensor, lens: Tensor | None, generator: torch.Generator
    ) -> Tensor:
        """From 100 SfM-like points, in as many looks as it will be used with."""
        pattern = SfmPattern(min_points=100, max_points=100, hole_share=0.0)
        sparse, trust = sample_like_sfm(rgb, depth, pattern, generator)
        log_sparse, median = normalise_log(sparse)
        with torch.autocast(rgb.device.type, torch.bfloat16, enabled=self.config.bf16):
            looks = min(MOST_LOOKS, self.config.looks)
            estimate = look_again(network.look, network.look, picture_inputs(rgb), log_sparse, trust, looks)
            return torch.exp(estimate.log_depth) * median


def _draw_grid(generator: torch.Generator) -> Grid:
    step = int(torch.randint(*GRID_STEPS, (), generator=generator))
    return Grid(step, int(torch.randint(step, (), generator=generator)))


class PaperTask:
    """L1 on metric depth from exact uniform points (paper, section III-B), for each network of its comparison.

    Depth is divided by one constant for all frames and networks, `unit_mm`, so that a network whose head starts near
    zero is not judged by how fast it learns the number 25.
    """

    def __init__(self, config: TrainConfig) -> None:
        self.config = config
        self.network: nn.Module = build_model(config.model, config.size)

    def loss(self, rgb: Tensor, depth: Tensor, lens: Tensor | None, generator: torch.Generator) -> Tensor:
        valid = (depth > 0) & (depth < self.config.max_depth_mm)
        sparse = sample_uniform(depth * valid, self.config.points, generator)
        return masked_l1(self._depth(self.network, rgb, sparse, lens), depth / self.config.unit_mm, valid)

    def predict(
        self, network: nn.Module, rgb: Tensor, depth: Tensor, lens: Tensor | None, generator: torch.Generator
    ) -> Tensor:
        """From as many uniform points as in training."""
        valid = (depth > 0) & (depth < self.config.max_depth_mm)
        sparse = sample_uniform(depth * valid, self.config.points, generator)
        return self._depth(network, rgb, sparse, lens) * self.config.unit_mm

    def _depth(self, network: nn.Module, rgb: Tensor, sparse: Tensor, lens: Tensor | None) -> Tensor:
        with torch.autocast(rgb.device.type, torch.bfloat16, enabled=self.config.bf16):
            return network(rgb, sparse / self.config.unit_mm, lens).float()


def make_task(config: TrainConfig) -> ScaleFreeTask | PaperTask:
    """The task that a configuration names."""
    return ScaleFreeTask(config) if config.model == "scale-free" else PaperTask(config)
