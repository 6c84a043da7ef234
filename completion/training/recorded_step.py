"""A training step as one CUDA graph: small networks spend most of a step on launching kernels one by one."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn

from completion.training.tasks import Drawn

WARM_UP = 11  # steps before the recording, in which libraries choose their kernels (torch's notes on CUDA graphs)


class RecordedStep:
    """Replays `compute` for inputs whose shapes stay the same: as `compute` itself, but its kernels are launched at
    once. The first `WARM_UP` steps are computed one by one; then one is recorded, without being taken."""

    def __init__(self, compute: Callable[[Drawn], Tensor]) -> None:
        """compute: takes a step and returns its loss, without waiting for the GPU."""
        self._compute = compute
        self._graph: torch.cuda.CUDAGraph | None = None
        self._inputs: Drawn | None = None
        self._loss = torch.zeros(())
        self._steps = 0

    def __call__(self, inputs: Drawn) -> Tensor:
        """The loss before the step, a scalar that the next call overwrites."""
        self._steps += 1
        if self._steps <= WARM_UP:
            return self._on_other_stream(inputs)
        if self._graph is None or self._inputs is None:
            self._inputs = copied(inputs)  # memory that each replay reads
            self._graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(self._graph):
                self._loss = self._compute(self._inputs)
        for kept, given in zip(self._inputs, inputs, strict=True):
            if kept is not None and given is not None:
                kept.copy_(given)
        self._graph.replay()
        return self._loss

    def _on_other_stream(self, inputs: Drawn) -> Tensor:
        """A recording may not have been warmed up on the default stream."""
        stream = torch.cuda.Stream()
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
            loss = self._compute(inputs)
        torch.cuda.current_stream().wait_stream(stream)
        return loss


def copied(inputs: Drawn) -> Drawn:
    """The same values in memory of their own."""
    lens = None if inputs.lens is None else inputs.lens.clone()
    return Drawn(inputs.rgb.clone(), inputs.depth.clone(), inputs.valid.clone(), inputs.sparse.clone(), lens)


def can_record(network: nn.Module, device: torch.device) -> bool:
    """Whether it is on CUDA and no module of it says `waits_for_gpu`, as one whose shapes depend on values must."""
    waits = any(getattr(module, "waits_for_gpu", False) for module in network.modules())
    return device.type == "cuda" and not waits
