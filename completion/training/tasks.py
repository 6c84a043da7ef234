"""Training tasks: a `DepthNetwork` on SfM-like points, or a metric network in the paper's setting.

Both draw sparse points from a batch of images and true depths in mm, and compute a loss and validation depth.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import torch
from torch import Tensor, nn

from completion.data.draws import integer_draw, on_host, uniform_draws
from completion.data.sampling_neighbours import merged, sample_like_neighbours
from completion.data.sampling_training import (
    SfmPattern,
    normalise_log,
    sample_by_chance,
    sample_keypoints,
    sample_like_sfm,
    sample_uniform,
)
from completion.networks.protocol import DepthNetwork, Estimate, SampleGrid, most_iterations
from completion.networks.recurrence import DEFAULT_ITERATIONS, refine_iteratively
from completion.networks.registry import build_model, find_entry
from completion.training.config import TrainConfig
from completion.training.losses import completion_loss, masked_l1
from haustra.core.errors import CompletionError

NEIGHBOURS_SHARE = 0.35  # share of the batches whose frames also have points from other frames' depths
GRID_STEPS = (6, 17)  # px: lower and (excluded) upper bound of a `SampleGrid.step` in training


class Task(Protocol):
    """Loss and validation of a network that is trained; `network` is saved in checkpoints."""

    network: nn.Module

    def loss(self, rgb: Tensor, depth: Tensor, lens: Tensor | None, generator: torch.Generator) -> Tensor:
        """Scalar loss of rgb (B,3,H,W) in [0,1], depth (B,1,H,W) mm with 0 = none, lens (B,4) fx fy cx cy px."""

    def predict(
        self, network: nn.Module, rgb: Tensor, depth: Tensor, lens: Tensor | None, generator: torch.Generator
    ) -> Tensor:
        """Completed depth (B,1,H,W) mm from points that validation draws of the true depth."""


class SfmTask:
    """Median-normalised log depth from random SfM-like patterns, for each `DepthNetwork`."""

    def __init__(self, config: TrainConfig, network: DepthNetwork) -> None:
        self.config = config
        self.iterations = most_iterations(network.config)
        self.network: nn.Module = network  # type: ignore[assignment]

    def loss(self, rgb: Tensor, depth: Tensor, lens: Tensor | None, generator: torch.Generator) -> Tensor:
        sparse, trust = sample_like_sfm(rgb, depth, SfmPattern(), generator)
        if uniform_draws((), on_host(generator)) < NEIGHBOURS_SHARE:
            # In the unit of the points: a frame's points and its neighbours' depths are of one map.
            sparse, trust = merged(sparse, trust, *sample_like_neighbours(depth, generator))
        log_sparse, median = normalise_log(sparse)
        valid = (depth > 0) & (depth < self.config.max_depth_mm)
        target = torch.log(depth.clamp_min(1e-3) / median).clamp(-3.9, 3.9)
        with torch.autocast(rgb.device.type, torch.bfloat16, enabled=self.config.bf16):
            last, grid = self._earlier_iterations(rgb, log_sparse, trust, generator)
            log_depth, log_error = self.network(rgb, log_sparse, trust, last, grid)
        return completion_loss(log_depth, log_error, target, valid)

    def _earlier_iterations(
        self, rgb: Tensor, log_sparse: Tensor, trust: Tensor, generator: torch.Generator
    ) -> tuple[Estimate | None, SampleGrid]:
        """The estimate after 0 to `iterations` - 1 iterations (None after 0), without gradients; the next's grid."""
        last = None
        earlier = integer_draw(0, self.iterations, generator)
        for _ in range(earlier):
            with torch.no_grad():
                last = self.network(rgb, log_sparse, trust, last, _draw_grid(generator))
        return last, _draw_grid(generator)

    def predict(
        self, network: nn.Module, rgb: Tensor, depth: Tensor, lens: Tensor | None, generator: torch.Generator
    ) -> Tensor:
        """Depth from 100 SfM-like points, in as many iterations as it will be used with."""
        assert isinstance(network, DepthNetwork)
        pattern = SfmPattern(min_points=100, max_points=100, hole_share=0.0)
        sparse, trust = sample_like_sfm(rgb, depth, pattern, generator)
        log_sparse, median = normalise_log(sparse)
        with torch.autocast(rgb.device.type, torch.bfloat16, enabled=self.config.bf16):
            image, iterations = network.prepare(rgb), min(DEFAULT_ITERATIONS, self.iterations)
            estimate = refine_iteratively(network.iterate, network.iterate, image, log_sparse, trust, iterations)
            return torch.exp(estimate.log_depth) * median


def _draw_grid(generator: torch.Generator) -> SampleGrid:
    step = integer_draw(*GRID_STEPS, generator)
    return SampleGrid(step, integer_draw(0, step, generator))


class Drawn(NamedTuple):
    """A batch with its points: image, true depth, where that is valid, sparse depth, lens or None."""

    rgb: Tensor
    depth: Tensor
    valid: Tensor
    sparse: Tensor
    lens: Tensor | None


class PaperTask:
    """L1 on metric depth from exact points (paper, section III-B), for each network of its comparison.

    Depth is divided by one constant for all frames and networks, `unit_mm`, so that a network whose head starts near
    zero is not judged by how fast it learns the number 25.
    """

    def __init__(self, config: TrainConfig, network: nn.Module) -> None:
        self.config = config
        self.network = network
        self._msc = getattr(network, "msc", None)
        self._msc_alone = False
        if config.msc_first and not isinstance(self._msc, nn.Module):
            raise CompletionError(f"{config.model} has no multi-scale confidence that could be trained first")

    def begin(self, step: int) -> None:
        """What learns in this step: with `msc_first` MSC alone at first, and from then on all but MSC."""
        if self.config.msc_first and self._msc is not None:
            self._msc_alone = step < self.config.msc_first
            self._msc.requires_grad_(self._msc_alone)

    def loss(self, rgb: Tensor, depth: Tensor, lens: Tensor | None, generator: torch.Generator) -> Tensor:
        return self.loss_of(self.draw(rgb, depth, lens, generator))

    def draw(self, rgb: Tensor, depth: Tensor, lens: Tensor | None, generator: torch.Generator) -> Drawn:
        """What `loss_of` takes; all that is random is drawn here."""
        valid = (depth > 0) & (depth < self.config.max_depth_mm)
        return Drawn(rgb, depth, valid, self._sample(rgb, depth * valid, generator), lens)

    def loss_of(self, drawn: Drawn) -> Tensor:
        """Scalar loss of what was drawn."""
        if self._msc_alone and self._msc is not None:
            sparse = drawn.sparse / self.config.unit_mm
            depth = self._msc(sparse, (sparse > 0).float())[0]
        else:
            depth = self._depth(self.network, drawn.rgb, drawn.sparse, drawn.lens)
        return masked_l1(depth, drawn.depth / self.config.unit_mm, drawn.valid)

    def predict(
        self, network: nn.Module, rgb: Tensor, depth: Tensor, lens: Tensor | None, generator: torch.Generator
    ) -> Tensor:
        """Depth from as many points of the same sampler as in training."""
        valid = (depth > 0) & (depth < self.config.max_depth_mm)
        sparse = self._sample(rgb, depth * valid, generator)
        return self._depth(network, rgb, sparse, lens) * self.config.unit_mm

    def _sample(self, rgb: Tensor, depth: Tensor, generator: torch.Generator) -> Tensor:
        if self.config.sampler == "features":
            return sample_keypoints(rgb, depth, self.config.points, generator)
        if self.config.sampler == "by_chance":
            return sample_by_chance(depth, self.config.points, generator)
        return sample_uniform(depth, self.config.points, generator)

    def _depth(self, network: nn.Module, rgb: Tensor, sparse: Tensor, lens: Tensor | None) -> Tensor:
        with torch.autocast(rgb.device.type, torch.bfloat16, enabled=self.config.bf16):
            return network(rgb, sparse / self.config.unit_mm, lens).float()


def make_task(config: TrainConfig) -> Task:
    """The task of the network that a configuration names, which is built from torch's current seed."""
    entry = find_entry(config.model)
    if entry.is_metric:
        return PaperTask(config, build_model(config.model, config.size))
    options = {name: getattr(config, name) for name in ("width", "anchor", "iterations") if name in entry.options()}
    network = build_model(config.model, **options)
    assert isinstance(network, DepthNetwork)
    return SfmTask(config, network)
