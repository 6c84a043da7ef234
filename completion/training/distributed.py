"""Several processes training one network: `torchrun --nproc-per-node N --no-python haustra train ...`."""

from __future__ import annotations

import os
from dataclasses import dataclass

import torch
import torch.distributed as dist
from torch import nn


@dataclass(frozen=True)
class ProcessGroup:
    """This process's place among `size`; alone it is 0 of 1."""

    rank: int = 0
    size: int = 1

    @classmethod
    def init(cls, device: torch.device) -> ProcessGroup:
        """The processes that torchrun's environment describes: NCCL between GPUs, Gloo between CPU processes."""
        size = int(os.environ.get("WORLD_SIZE", "1"))
        if size == 1:
            return cls()
        if device.type == "cuda":
            torch.cuda.set_device(int(os.environ["LOCAL_RANK"]))
        if not dist.is_initialized():
            dist.init_process_group("nccl" if device.type == "cuda" else "gloo")
        return cls(dist.get_rank(), size)

    def shutdown(self) -> None:
        """At the end of the training, after what the first writes alone."""
        if self.size > 1:
            dist.barrier()
            dist.destroy_process_group()

    @property
    def is_first(self) -> bool:
        """Whether to write checkpoints, logs and weights."""
        return self.rank == 0

    def average_gradients(self, network: nn.Module) -> None:
        """Mean of all processes' gradients, as torch's own data-parallel training takes it."""
        if self.size > 1:
            self._average([p.grad for p in network.parameters() if p.grad is not None])

    def average_statistics(self, network: nn.Module) -> None:
        """Mean of the batch normalisations' running statistics; within a step each process uses its own batch's."""
        if self.size > 1:
            self._average([b for b in network.buffers() if b.is_floating_point()])

    def _average(self, tensors: list[torch.Tensor]) -> None:
        for tensor in tensors:
            dist.all_reduce(tensor)
            tensor /= self.size
