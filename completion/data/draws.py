"""Random numbers on the device of their generator.

A CPU's generator gives the same numbers whichever device they are then used on; a GPU's own saves drawing millions of
them on the CPU and copying them, and gives others.
"""

from collections.abc import Sequence

import torch
from torch import Tensor


def uniform_draws(shape: Sequence[int], generator: torch.Generator) -> Tensor:
    """float32 in [0, 1)."""
    return torch.rand(tuple(shape), generator=generator, device=generator.device)


def normal_draws(shape: Sequence[int], generator: torch.Generator) -> Tensor:
    """float32 of mean 0 and standard deviation 1."""
    return torch.randn(tuple(shape), generator=generator, device=generator.device)


def integer_draw(low: int, beyond: int, generator: torch.Generator) -> int:
    """One integer, low <= it < beyond."""
    return int(torch.randint(low, beyond, (), generator=generator, device=generator.device))
