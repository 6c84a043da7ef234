"""Data-parallel training by several processes: `torchrun --nproc-per-node N --no-python haustra train ...`."""

from __future__ import annotations

import os
from dataclasses import dataclass

import torch
import torch.distributed as dist
from torch import nn


@dataclass(frozen=True)
class ProcessGroup:
    """Rank of this process among `size` processes; 0 of 1 without torchrun."""

    rank: int = 0
    size: int = 1

    @classmethod
    def init(cls, device: torch.device) -> ProcessGroup:
        """Initialise from torchrun's environment: NCCL between GPUs, Gloo between CPU processes."""
        size = int(os.environ.get("WORLD_SIZE", "1"))
        if size == 1:
            return cls()
        if device.type == "cuda":
            torch.cuda.set_device(int(os.environ["LOCAL_RANK"]))
        if not dist.is_initialized():
            dist.init_process_group("nccl" if device.type == "cuda" else "gloo")
        return cls(dist.get_rank(), size)

    def shutdown(self) -> None:
        """Wait for all processes, of which the first may still write files, and leave the group."""
        if self.size > 1:
            dist.barrier()
            dist.destroy_process_group()

    @property
    def is_first(self) -> bool:
        """Whether this process writes checkpoints, logs and weights."""
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
