"""Random numbers on the device of their generator.

A CPU's generator gives the same numbers whichever device they are then used on; a GPU's own saves drawing millions of
them on the CPU and copying them, and gives others. What the CPU has to know, as how often a network is run, is drawn by
a generator of its own (`on_host`): read back from a GPU, a number waits for all that the GPU was told to do before.
"""

from collections.abc import Sequence

import torch
from torch import Tensor


class DeviceGenerator(torch.Generator):
    """A generator on a device, with one on the CPU for the numbers that the CPU has to know."""

    on_host: torch.Generator

    @classmethod
    def seeded(cls, device: torch.device, seed: int) -> "DeviceGenerator":
        generator = cls(device)
        generator.manual_seed(seed)
        generator.on_host = torch.Generator().manual_seed(seed)
        return generator


def on_host(generator: torch.Generator) -> torch.Generator:
    """The generator of numbers that the CPU has to know: the same one, but for a `DeviceGenerator`."""
    return generator.on_host if isinstance(generator, DeviceGenerator) else generator


def moved(values: Tensor, device: torch.device) -> Tensor:
    """A few numbers of the CPU on a device, which does not have to finish its work before."""
    return values.to(device, non_blocking=True)


def uniform_draws(shape: Sequence[int], generator: torch.Generator) -> Tensor:
    """float32 in [0, 1)."""
    return torch.rand(tuple(shape), generator=generator, device=generator.device)


def normal_draws(shape: Sequence[int], generator: torch.Generator) -> Tensor:
    """float32 of mean 0 and standard deviation 1."""
    return torch.randn(tuple(shape), generator=generator, device=generator.device)


def integer_draw(low: int, beyond: int, generator: torch.Generator) -> int:
    """One integer, low <= it < beyond."""
    generator = on_host(generator)
    return int(torch.randint(low, beyond, (), generator=generator, device=generator.device))
