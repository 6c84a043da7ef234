"""Train the scale-free MSCSA-Net on shards of rendered frames: one loop, read from top to bottom.

    python -m completion.train SHARDS [SHARDS ...] --out weights.safetensors --seed 0 --steps 12000

Killed at any time it goes on from its last checkpoint (`OUT.checkpoint`, every few minutes) when called again with
the same arguments.
"""

import argparse
import copy
import json
import math
import time
from pathlib import Path

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from completion.checkpoint import (
    flatten_optimizer,
    load_tensors,
    restore_optimizer,
    save_network,
    save_tensors,
)
from completion.dataset import Shard, augment
from completion.errors import CompletionError
from completion.losses import completion_loss
from completion.network import ScaleFreeConfig, ScaleFreeMSCSANet
from completion.sampling import SfmPattern, normalise_log, sample_like_sfm


class TrainConfig(BaseModel):
    """What a training run depends on; saved with the weights."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    shards: tuple[Path, ...]
    out: Path
    seed: int = 0
    steps: int = Field(12000, gt=0)
    batch: int = Field(8, gt=0)
    learning_rate: float = Field(2e-3, gt=0)
    warm_up: int = 300  # steps of linear growth before the cosine
    ema: float = 0.998  # of the weights that are kept; a horizon of 500 steps
    width: int = 16
    max_depth_mm: float = 250.0  # truth beyond carries no image detail at these resolutions
    checkpoint_seconds: float = 120.0
    threads: int = 2


class Run:
    """Everything that a checkpoint must hold."""

    def __init__(self, config: TrainConfig) -> None:
        torch.manual_seed(config.seed)
        self.config = config
        self.network = ScaleFreeMSCSANet(ScaleFreeConfig(width=config.width))
        self.network.to(memory_format=torch.channels_last).train()
        self.average = copy.deepcopy(self.network).eval()
        self.optimizer = torch.optim.AdamW(self.network.parameters(), config.learning_rate, weight_decay=0.01)
        self.step = 0

    @property
    def checkpoint(self) -> Path:
        return self.config.out.with_suffix(".checkpoint")

    def save(self) -> None:
        tensors = {f"network.{n}": t for n, t in self.network.state_dict().items()}
        tensors |= {f"average.{n}": t for n, t in self.average.state_dict().items()}
        tensors |= flatten_optimizer(self.optimizer)
        save_tensors(self.checkpoint, tensors, {"step": self.step, "config": self._identity()})

    def resume(self) -> None:
        if not self.checkpoint.exists():
            return
        tensors, metadata = load_tensors(self.checkpoint)
        if metadata["config"] != self._identity():
            raise CompletionError(f"{self.checkpoint} is of a run with other settings; give another --out")
        for name, module in (("network.", self.network), ("average.", self.average)):
            module.load_state_dict({n[len(name) :]: t for n, t in tensors.items() if n.startswith(name)})
        restore_optimizer(self.optimizer, tensors)
        self.step = metadata["step"]

    def _identity(self) -> dict[str, object]:
        return json.loads(self.config.model_dump_json(exclude={"threads", "checkpoint_seconds", "out"}))


def learning_rate(step: int, config: TrainConfig) -> float:
    """Linear warm-up, then a cosine to one per cent."""
    if step < config.warm_up:
        return config.learning_rate * (step + 1) / config.warm_up
    progress = (step - config.warm_up) / max(1, config.steps - config.warm_up)
    return config.learning_rate * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * min(1.0, progress))))


def update_average(average: torch.nn.Module, network: torch.nn.Module, decay: float) -> None:
    """Exponential moving average of parameters and of batch statistics."""
    with torch.no_grad():
        for old, new in zip(average.state_dict().values(), network.state_dict().values(), strict=True):
            if old.is_floating_point():
                old.lerp_(new, 1 - decay)
            else:
                old.copy_(new)


def forward_loss(
    network: ScaleFreeMSCSANet, rgb: Tensor, depth: Tensor, config: TrainConfig, generator: torch.Generator
) -> Tensor:
    """Sparsify, normalise, predict; the loss is in log depth over the points' own median."""
    sparse, trust = sample_like_sfm(rgb, depth, SfmPattern(), generator)
    log_sparse, median = normalise_log(sparse)
    valid = (depth > 0) & (depth < config.max_depth_mm)
    target = torch.log(depth.clamp_min(1e-3) / median).clamp(-3.9, 3.9)
    with torch.autocast("cpu", torch.bfloat16):
        log_depth, log_error = network(rgb, log_sparse, trust)
    return completion_loss(log_depth, log_error, target, valid)


def validate(run: Run, shards: list[Shard], frames: int = 64) -> float:
    """Mean relative depth error of the averaged weights on held-out meshes, 100 SfM-like points."""
    generator = torch.Generator().manual_seed(1)
    pattern = SfmPattern(min_points=100, max_points=100, hole_share=0.0)
    errors = []
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
        for shard in shards:
            held_out = shard.split()[1]
            chosen = held_out[:: max(1, len(held_out) // frames)][:frames]
            for start in range(0, len(chosen), 8):
                rgb, depth = shard.batch(chosen[start : start + 8])
                sparse, trust = sample_like_sfm(rgb, depth, pattern, generator)
                log_sparse, median = normalise_log(sparse)
                predicted = torch.exp(run.average(rgb, log_sparse, trust)[0]) * median
                valid = (depth > 0) & (depth < run.config.max_depth_mm)
                errors.append(((predicted - depth).abs() / depth.clamp_min(1e-3))[valid].mean().item())
    return float(np.mean(errors))


def train(config: TrainConfig) -> Path:
    """Run to the end (or on from the last checkpoint) and write the averaged weights."""
    torch.set_num_threads(config.threads)
    shards = [Shard.open(folder) for folder in config.shards]
    splits = [shard.split()[0] for shard in shards]
    share = np.array([len(split) for split in splits]) / sum(len(split) for split in splits)
    run = Run(config)
    run.resume()
    saved = started = time.monotonic()
    first, losses = run.step, []
    while run.step < config.steps:
        # One generator per step, so that a resumed run draws what an unbroken one would have drawn.
        numpy_rng = np.random.default_rng((config.seed, run.step))
        generator = torch.Generator().manual_seed(int(numpy_rng.integers(2**62)))
        which = numpy_rng.choice(len(shards), p=share)
        rgb, depth = shards[which].batch(numpy_rng.choice(splits[which], config.batch, replace=False))
        rgb, depth = augment(rgb, depth, generator)
        for group in run.optimizer.param_groups:
            group["lr"] = learning_rate(run.step, config)
        loss = forward_loss(run.network, rgb, depth, config, generator)
        run.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(run.network.parameters(), 1.0)
        run.optimizer.step()
        run.step += 1
        update_average(run.average, run.network, min(config.ema, run.step / (run.step + 10)))
        losses.append(loss.item())
        if run.step % 100 == 0:
            rate = (run.step - first) * config.batch / (time.monotonic() - started)
            print(
                f"step {run.step}/{config.steps}  loss {np.mean(losses[-100:]):.4f}  {rate:.1f} img/s",
                flush=True,
            )
        if run.step % 1000 == 0:
            print(f"step {run.step}  held-out abs.REL {100 * validate(run, shards):.2f} %", flush=True)
        if time.monotonic() - saved > config.checkpoint_seconds:
            run.save()
            saved = time.monotonic()
    run.save()
    about = {"steps": run.step, "seed": config.seed, "held_out_abs_rel": validate(run, shards)}
    save_network(config.out, run.average, run.average.state_dict(), about)
    return config.out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("shards", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    for name in ("seed", "steps", "batch", "width", "threads"):
        parser.add_argument(f"--{name}", type=int, default=TrainConfig.model_fields[name].default)
    print(train(TrainConfig(**vars(parser.parse_args()))))


if __name__ == "__main__":
    main()
