"""Train a completion network on shards of rendered frames: one loop, read from top to bottom.

    haustra train SHARDS [SHARDS ...] --out weights.safetensors --seed 0 --steps 12000

Killed at any time it goes on from its last checkpoint (`OUT.checkpoint`, every few minutes and at Ctrl-C) when called
again with the same arguments. Beside the weights lie the files of `log.TrainLog`. Several processes share the batch:

    torchrun --nproc-per-node 2 --no-python haustra train SHARDS --out weights.safetensors
"""

from __future__ import annotations

import copy
import json
import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.optim.swa_utils import get_ema_multi_avg_fn

from completion.data.shards import Shard
from completion.inference.completer import choose_device
from completion.networks.checkpoint import (
    flatten_optimizer,
    load_network,
    load_tensors,
    reason,
    restore_optimizer,
    save_network,
    save_tensors,
)
from completion.networks.registry import find_entry
from completion.training.batches import draw_batch, shards_of_one_size
from completion.training.config import TrainConfig, with_new_names
from completion.training.distributed import ProcessGroup
from completion.training.graceful_interrupt import GracefulInterrupt
from completion.training.log import Say, TrainLog
from completion.training.plateau import EVERY as PLATEAU_EVERY
from completion.training.plateau import Plateau
from completion.training.recorded_step import RecordedStep, can_record
from completion.training.tasks import PaperTask, make_task
from haustra.core.errors import CompletionError

LOG_EVERY, VALIDATE_EVERY = 100, 1000
# What checkpoints that do not name these were trained with.
LATER_SETTINGS = {"clip": 1.0, "sampler": "uniform", "msc_first": 0, "mix_shards": False, "passes": False}
LATER_SETTINGS |= {"draw_on": "cpu"}
ProgressCallback = Callable[[int, int | None], None]


class TrainingState:
    """The state of a training run that a checkpoint holds."""

    def __init__(self, config: TrainConfig) -> None:
        torch.manual_seed(config.seed)
        self.config = config
        self.device = choose_device(config.device)
        self.processes = ProcessGroup.init(self.device)
        self.task = make_task(config)
        if config.init is not None:
            _start_from(config.init, self.task.network)
        self.task.network.to(self.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.task.network.train()
        self.average = copy.deepcopy(self.task.network).eval()
        self.recorded: RecordedStep | None = None
        task, alone = self.task, self.processes.size == 1
        if isinstance(task, PaperTask) and not config.msc_first and alone and can_record(task.network, self.device):
            self.recorded = RecordedStep(lambda drawn: optimise(self, lambda: task.loss_of(drawn)))
        # A recording reads the rate from a tensor.
        rate = torch.tensor(config.learning_rate, device=self.device) if self.recorded else config.learning_rate
        kind = torch.optim.AdamW if config.optimizer == "adamw" else torch.optim.Adam
        decay = 0.01 if config.optimizer == "adamw" else 0.0
        parameters = self.task.network.parameters()
        self.optimizer = kind(parameters, rate, weight_decay=decay, capturable=self.recorded is not None)
        self.step = 0
        self.steps_on: dict[str, int] = {}  # by device, since a run can go on elsewhere
        self.plateau = Plateau(config.steps) if config.schedule == "plateau" else None

    @property
    def steps(self) -> int:
        """Number of steps of the whole run, as far as it is known."""
        return self.plateau.steps if self.plateau else self.config.steps

    @property
    def rate(self) -> float:
        """Learning rate of the next step."""
        if self.plateau:
            return self.config.learning_rate * (0.1 if self.plateau.cooled_at else 1.0)
        return learning_rate(self.step, self.config)

    def advance(self) -> None:
        """Count a step, and where it was made."""
        where = torch.cuda.get_device_name(self.device) if self.device.type == "cuda" else self.device.type
        self.step += 1
        self.steps_on[where] = self.steps_on.get(where, 0) + 1

    @property
    def checkpoint(self) -> Path:
        return self.config.out.with_suffix(".checkpoint")

    def save(self) -> None:
        tensors = {f"network.{n}": t for n, t in self.task.network.state_dict().items()}
        tensors |= {f"average.{n}": t for n, t in self.average.state_dict().items()}
        tensors |= flatten_optimizer(self.optimizer)
        about = {"step": self.step, "steps_on": self.steps_on, "config": self._identity()}
        about |= {"plateau": asdict(self.plateau)} if self.plateau else {}
        save_tensors(self.checkpoint, tensors, about)

    def resume(self) -> None:
        if not self.checkpoint.exists():
            return
        tensors, metadata = load_tensors(self.checkpoint)
        now = self._identity()
        before: dict[str, Any] = LATER_SETTINGS | with_new_names(metadata["config"])
        if [Path(name).name for name in before["shards"]] == [folder.name for folder in self.config.shards]:
            before["shards"] = now["shards"]  # of a checkpoint that named the folders instead of their frames
        if other := sorted(name for name in before.keys() | now.keys() if before.get(name) != now.get(name)):
            raise CompletionError(f"{self.checkpoint} is of a run with other {', '.join(other)}; give another --out")
        for name, module in (("network.", self.task.network), ("average.", self.average)):
            module.load_state_dict({n[len(name) :]: t for n, t in tensors.items() if n.startswith(name)})
        restore_optimizer(self.optimizer, tensors)
        self.step = metadata["step"]
        self.steps_on = metadata.get("steps_on", {"not recorded": self.step})
        if self.plateau:
            self.plateau = Plateau(**metadata["plateau"])

    def _identity(self) -> dict[str, Any]:
        settings = self.config.model_dump_json(exclude={"threads", "checkpoint_seconds", "out", "device"})
        return with_new_names(json.loads(settings)) | {"processes": self.processes.size} | self._frames

    @cached_property
    def _frames(self) -> dict[str, Any]:
        """Which frames these are, and whether a batch has frames of several shards."""
        shards = [Shard.open(folder) for folder in self.config.shards]
        mixes = self.config.mix_shards and any(len(group) > 1 for group in shards_of_one_size(shards))
        return {"shards": [shard.fingerprint() for shard in shards], "mix_shards": mixes}


def _start_from(path: Path, network: nn.Module) -> None:
    """Copy a weight file's tensors into a network of the same kind and size."""
    given = load_network(path)
    if type(given) is not type(network):
        raise CompletionError(f"{path} holds a {type(given).__name__}, not a {type(network).__name__}")
    try:
        network.load_state_dict(given.state_dict())
    except RuntimeError as error:
        raise CompletionError(f"the weights in {path} do not fit: {reason(error)}") from error


def learning_rate(step: int, config: TrainConfig) -> float:
    """Linear warm-up, then a cosine to one per cent, or a constant that falls to a tenth once or after each third."""
    if step < config.warm_up:
        return config.learning_rate * (step + 1) / config.warm_up
    if config.schedule == "step":
        return config.learning_rate * (0.1 if step >= config.decay_at * config.steps else 1.0)
    if config.schedule == "thirds":
        return config.learning_rate * 0.1 ** (3 * step // config.steps)
    progress = (step - config.warm_up) / max(1, config.steps - config.warm_up)
    return config.learning_rate * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * min(1.0, progress))))


def update_average(average: nn.Module, network: nn.Module, decay: float) -> None:
    """Exponential moving average of parameters and of batch statistics."""
    pairs = list(zip(average.state_dict().values(), network.state_dict().values(), strict=True))
    moving = [(old, new) for old, new in pairs if old.is_floating_point()]
    get_ema_multi_avg_fn(decay)([old for old, _ in moving], [new for _, new in moving], None)
    with torch.no_grad():
        for old, new in pairs:
            if not old.is_floating_point():
                old.copy_(new)


def validate(run: TrainingState, shards: list[Shard], frames: int = 64) -> float:
    """Mean relative depth error of the averaged weights on held-out meshes, `frames` of each shard folder."""
    generator = torch.Generator().manual_seed(1)
    errors = []
    with torch.no_grad():
        for shard in shards:
            held_out = shard.split()[1]
            chosen = held_out[:: max(1, len(held_out) // frames)][:frames]
            for start in range(0, len(chosen), 8):
                batch = shard.batch(chosen[start : start + 8], run.device).to(run.device)
                depth = batch.depth
                predicted = run.task.predict(run.average, batch.rgb, depth, batch.lens, generator)
                valid = (depth > 0) & (depth < run.config.max_depth_mm)
                errors.append(((predicted - depth).abs() / depth.clamp_min(1e-3))[valid].mean().item())
    return float(np.mean(errors))


def train_step(run: TrainingState, shards: list[Shard], splits: list[NDArray[np.int64]]) -> Tensor:
    """One step of the optimizer; returns the loss, a scalar that a GPU may not have computed yet."""
    batch, generator = draw_batch(run.config, run.step, shards, splits, run.processes, run.device)
    torch.manual_seed(generator.initial_seed())  # for dropout: resumed, a run must drop what an unbroken one would
    for group in run.optimizer.param_groups:
        if run.recorded:
            group["lr"].fill_(run.rate)
        else:
            group["lr"] = run.rate
    if isinstance(run.task, PaperTask):
        run.task.begin(run.step)
    if run.recorded and isinstance(run.task, PaperTask):
        loss = run.recorded(run.task.draw(batch.rgb, batch.depth, batch.lens, generator))
    else:
        loss = optimise(run, lambda: run.task.loss(batch.rgb, batch.depth, batch.lens, generator))
    run.advance()
    update_average(run.average, run.task.network, min(run.config.ema, run.step / (run.step + 10)))
    return loss.clone()  # a recorded step writes the next loss into the same memory


def optimise(run: TrainingState, loss_of: Callable[[], Tensor]) -> Tensor:
    """Follow the gradient of a loss by one step; returns the loss before it."""
    loss = loss_of()
    run.optimizer.zero_grad(set_to_none=True)
    loss.backward()
    run.processes.average_gradients(run.task.network)
    run.processes.average_statistics(run.task.network)
    if run.config.clip:
        nn.utils.clip_grad_norm_(run.task.network.parameters(), run.config.clip)
    run.optimizer.step()
    return loss.detach()


def train(config: TrainConfig, advance: ProgressCallback | None = None, say: Say = print) -> Path:
    """Run to the end (or on from the last checkpoint) and write the averaged weights."""
    torch.set_num_threads(config.threads)
    shards = [Shard.open(folder) for folder in config.shards]
    run = TrainingState(config)
    _check(shards, config, run.processes.size)
    run.resume()
    splits = [shard.split()[0] for shard in shards]
    if config.draw_on == "device" and run.device.type != "cpu":
        shards = [shard.held_on(run.device) for shard in shards]
    config.out.parent.mkdir(parents=True, exist_ok=True)
    log = TrainLog(config.out, say) if run.processes.is_first else None
    if log and run.step:
        say(f"going on from step {run.step} of {run.steps}, where {run.checkpoint} ends")
    losses: deque[Tensor] = deque(maxlen=LOG_EVERY)  # since the last line of the log
    saved = time.monotonic()
    with GracefulInterrupt(run.processes.size == 1) as interrupt:
        while run.step < run.steps and not interrupt.requested:
            rate = run.rate
            losses.append(train_step(run, shards, splits))
            if advance and log:
                advance(run.step, run.steps)
            if log and (run.step % LOG_EVERY == 0 or run.step == run.steps):
                due = run.step % (PLATEAU_EVERY if run.plateau else VALIDATE_EVERY) == 0
                held_out = validate(run, shards) if due else None
                lately = torch.stack(list(losses)).double().mean().item()
                losses.clear()
                log.write(run.step, run.steps, lately, rate, held_out)
                if run.plateau and held_out is not None:
                    run.plateau.update(run.step, held_out)
            if log and time.monotonic() - saved > config.checkpoint_seconds:
                run.save()
                saved = time.monotonic()
    if run.step < run.steps:
        run.save()
        raise KeyboardInterrupt
    if log:
        run.save()
        about = {"steps": run.step, "seed": config.seed, "held_out_abs_rel": validate(run, shards)}
        about["unit_mm"] = config.unit_mm
        about["training"] = json.loads(config.model_dump_json(exclude={"shards", "out", "init"}))
        save_network(config.out, run.average, run.average.state_dict(), about)
    run.processes.shutdown()
    return config.out


def _check(shards: list[Shard], config: TrainConfig, processes: int) -> None:
    if config.batch % processes:
        raise CompletionError(f"a batch of {config.batch} cannot be shared evenly by {processes} processes")
    if config.schedule == "plateau" and processes > 1:
        raise CompletionError("the schedule 'plateau' is for one process, which measures the held-out error")
    if config.passes and len(shards_of_one_size(shards) if config.mix_shards else shards) > 1:
        raise CompletionError("passes over all frames need frames of one size, in one batch")
    for shard, folder in zip(shards, config.shards, strict=True):
        if too_few := shard.too_few_for(config.batch):
            raise CompletionError(f"{folder} {too_few}")
        if find_entry(config.model).needs_intrinsics and shard.lenses is None:
            raise CompletionError(f"{folder} has no intrinsics.npy, which {config.model} needs")
