"""Convolutions for inference on a CPU: with their ReLU in one pass, and with weights laid out once, not each time.

Both are oneDNN's, by the operators that PyTorch's own compiler puts in their place. Those have no public name, so where
a version of PyTorch or a processor lacks them the network stays as it is: the same function, a sixth slower.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from completion.network import DoubleConv


class FusedConvReLU(nn.Module):
    """ReLU of a convolution (B,in,H,W) -> (B,out,H,W), on a CPU and without gradients."""

    def __init__(self, conv: nn.Conv2d) -> None:
        super().__init__()
        self.conv = conv
        self._lay_out()

    def _lay_out(self) -> None:
        conv = self.conv
        self._shape: Any = [list(conv.padding), list(conv.stride), list(conv.dilation), conv.groups]
        self._weight = torch._C._nn.mkldnn_reorder_conv2d_weight(conv.weight.detach().to_mkldnn(), *self._shape)

    def forward(self, x: Tensor) -> Tensor:
        return torch.ops.mkldnn._convolution_pointwise(x, self._weight, self.conv.bias, *self._shape, "relu", [], "")

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_weight"}  # it can't be copied

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)
        self._lay_out()


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
