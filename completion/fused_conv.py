"""Convolutions for inference on a CPU: with their ReLU in one pass, and with weights laid out once, not each time.

Both are oneDNN's, by the operators that PyTorch's own compiler puts in their place. Those have no public name, so where
a version of PyTorch or a processor lacks them the network stays as it is: the same function, a sixth slower.
"""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from completion.network import DoubleConv

# px. On processors without AMX oneDNN wants weights of up to 12 columns laid out in another way and does so anew in
# every call, at thirty times the convolution's cost. The U-Net's deepest level is that narrow.
NARROW = 16


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
        if x.shape[3] < NARROW:
            return self._as_product(x)
        return torch.ops.mkldnn._convolution_pointwise(x, self._weight, self.conv.bias, *self._shape, "relu", [], "")

    def _as_product(self, x: Tensor) -> Tensor:
        """The same, as one matrix product of every pixel's neighbourhood: for small pictures. Stride 1, one group."""
        weight, (rows, columns) = self.conv.weight, self.conv.kernel_size
        (batch, _, height, width), (above, left) = x.shape, self.conv.padding
        around = F.pad(x, (left, left, above, above)).permute(0, 2, 3, 1)
        shifted = [around[:, i : i + height, j : j + width] for i in range(rows) for j in range(columns)]
        kernel = weight.permute(2, 3, 1, 0).reshape(-1, weight.shape[0])
        out = torch.addmm(self.conv.bias, torch.cat(shifted, dim=3).flatten(0, 2), kernel).relu_()
        return out.view(batch, height, width, -1).permute(0, 3, 1, 2)

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
