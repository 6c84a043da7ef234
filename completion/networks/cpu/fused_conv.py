"""Convolution and ReLU fused for inference on a CPU, with prepacked weights.

By oneDNN, through the operators that torch.compile emits. These have no public name: where a version of PyTorch or a
processor lacks them the network stays unfused, the same function and a sixth slower.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn

from completion.networks.mscsa import DoubleConv

SHAPES = 4  # most recent input shapes for which prepacked weights are kept


class Layouts:
    """Cache of prepacked weights by input shape.

    The layout that oneDNN wants depends on the input's shape; given another it repacks in every call, which took up to
    200 times as long as the convolution of a small image.
    """

    def __init__(self) -> None:
        self._kept: dict[tuple[int, ...], Tensor] = {}

    def of(self, x: Tensor, lay_out: Callable[[list[int]], Tensor]) -> Tensor:
        """Weights prepacked by `lay_out` for the shape of x, cached."""
        shape = tuple(x.shape)
        laid_out = self._kept.get(shape)
        if laid_out is None:
            laid_out = lay_out(list(shape))
            self._kept = dict([*self._kept.items(), (shape, laid_out)][-SHAPES:])  # another thread may be reading
        return laid_out

    def __reduce__(self) -> tuple[type, tuple[()]]:
        return Layouts, ()  # prepacked weights cannot be copied


class FusedConvReLU(nn.Module):
    """ReLU of a convolution (B,in,H,W) -> (B,out,H,W), on a CPU and without gradients."""

    def __init__(self, conv: nn.Conv2d) -> None:
        super().__init__()
        self.conv = conv
        self._shape: Any = [list(conv.padding), list(conv.stride), list(conv.dilation), conv.groups]
        self._layouts = Layouts()

    def forward(self, x: Tensor) -> Tensor:
        weight = self._layouts.of(x, self._laid_out)
        return torch.ops.mkldnn._convolution_pointwise(x, weight, self.conv.bias, *self._shape, "relu", [], "")

    def _laid_out(self, shape: list[int]) -> Tensor:
        plain = self.conv.weight.detach().to_mkldnn()
        return torch._C._nn.mkldnn_reorder_conv2d_weight(plain, *self._shape, shape)  # type: ignore[call-arg]


def can_fuse(dtype: torch.dtype) -> bool:
    """Whether this PyTorch and this processor have what `FusedConvReLU` needs."""
    reorder = hasattr(torch._C._nn, "mkldnn_reorder_conv2d_weight")
    if not (torch.backends.mkldnn.is_available() and reorder and hasattr(torch.ops.mkldnn, "_convolution_pointwise")):
        return False
    return dtype != torch.bfloat16 or torch.ops.mkldnn._is_mkldnn_bf16_supported()


def fuse_convolutions(network: nn.Module) -> None:
    """Replace, in place, the convolutions and ReLUs of every `DoubleConv` whose normalisation is folded already."""
    for block in network.modules():
        if isinstance(block, DoubleConv):
            for index in (0, 3):
                block[index] = FusedConvReLU(block[index])  # type: ignore[arg-type]
                block[index + 2] = nn.Identity()
