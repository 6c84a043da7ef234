"""What is trained: ours on points as structure from motion gives them, or the paper's setting for any network.

Both take a batch of images and true depths in millimetres, draw the points, and give a loss and a validation error.
"""

from __future__ import annotations

from functools import partial
from typing import Protocol

import torch
from torch import Tensor, nn

from completion.feedback import look_again, with_own_points
from completion.losses import completion_loss, masked_l1
from completion.models import build_model
from completion.sampling import SfmPattern, normalise_log, sample_like_sfm, sample_uniform
from completion.scale_free import ScaleFreeConfig, ScaleFreeMSCSANet
from completion.train_config import TrainConfig

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
            seen, seen_trust = self._earlier_looks(rgb, log_sparse, trust, generator)
            log_depth, log_error = self.network(rgb, seen, seen_trust, again=seen is not log_sparse)
        return completion_loss(log_depth, log_error, target, valid)

    def _earlier_looks(
        self, rgb: Tensor, log_sparse: Tensor, trust: Tensor, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """The points as a look after none to `looks` - 1 others finds them; those others are not trained through."""
        seen, seen_trust = log_sparse, trust
        for _ in range(int(torch.randint(self.config.looks, (), generator=generator))):
            with torch.no_grad():
                log_depth, log_error = self.network(rgb, seen, seen_trust, again=seen is not log_sparse)
            step = int(torch.randint(*GRID_STEPS, (), generator=generator))
            first = int(torch.randint(step, (), generator=generator))
            seen, seen_trust = with_own_points(log_sparse, trust, log_depth, log_error, step, first)
        return seen, seen_trust

    def predict(
        self, network: nn.Module, rgb: Tensor, depth: Tensor, lens: Tensor | None, generator: torch.Generator
    ) -> Tensor:
        """From 100 SfM-like points, in `looks` looks."""
        pattern = SfmPattern(min_points=100, max_points=100, hole_share=0.0)
        sparse, trust = sample_like_sfm(rgb, depth, pattern, generator)
        log_sparse, median = normalise_log(sparse)
        with torch.autocast(rgb.device.type, torch.bfloat16, enabled=self.config.bf16):
            later = partial(network, again=True)
            return torch.exp(look_again(network, later, rgb, log_sparse, trust, self.config.looks)[0]) * median


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
