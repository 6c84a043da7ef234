"""The U-Net in int8 for inference: AVX-512 VNNI multiplies 8-bit integers at twice the rate of bfloat16.

After a ReLU channel c is uint8, round(x / s_c) clipped at 255, and the step s_c is multiplied into the weights of the
next convolution; one step per layer instead raised the depth error by up to a quarter. The range comes from the batch
normalisation, of shift beta and scale gamma: s_c = (beta + 8 |gamma|) / 255, without calibration images (Nagel et al.,
"Data-free quantization", ICCV 2019). Signed tensors, the input and the attention's output, have the zero point 128.
Weights are int8 with a scale per output channel; sums are exact in int32. The attention, the deepest and the last
features and the head stay in floating point.
"""

from __future__ import annotations

import copy
from functools import cache
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from completion.networks.cpu.fused_conv import Layouts, can_fuse
from completion.networks.cpu.int8_resize import LARGEST, MIDDLE, WORD, beside_doubled, words_of
from completion.networks.mscsa import UNet

# Standard deviations of an activation's range; the best of 4, 6, 8, 12 and 16 on 40 rendered validation frames: fewer
# clip too much, more are coarser.
DEVIATIONS = 8.0
MAX_STEPS = LARGEST - MIDDLE  # greatest value of a signed tensor, in steps
# Levels into which a second channel divides one step of an input that needs more than 8 bits (its residual). As good as
# 8 on those frames, better than 16, whose weights have too few bits left.
RESIDUAL_STEPS = 4


@cache
def can_use_int8() -> bool:
    """Whether this processor has VNNI and this PyTorch uses it; without, oneDNN saturates sums at 16 bits."""
    supported = getattr(torch.cpu, "_is_vnni_supported", None)
    if not (supported and supported() and can_fuse(torch.float32)):
        return False
    with torch.random.fork_rng(devices=[]):  # its weights are replaced; nobody's random numbers are used up
        conv = nn.Conv2d(64, 16, 3).requires_grad_(False)
    conv.weight.fill_(1)
    conv.bias.zero_()  # type: ignore[union-attr]
    try:
        for zero in (0, MIDDLE):
            made = Int8ConvReLU(conv, torch.ones(64), torch.ones(16), torch.float32, zero)
            sums = made(torch.full((1, 64, 3, 3), LARGEST, dtype=torch.uint8))
            if not torch.allclose(sums, torch.full_like(sums, 9 * 64 * (LARGEST - zero))):
                return False
    except (AttributeError, RuntimeError, TypeError):  # a PyTorch without these operators, or with others of the name
        return False
    return True


class Int8UNet(nn.Module):
    """A `UNet` with int8 convolutions: the output of `joined` (B,C,H,W) uint8 -> (B,out,H,W); H, W as of the `UNet`."""

    input_ranges: Tensor
    deepest: Tensor

    def __init__(
        self,
        folded: UNet,
        ranges: list[tuple[Tensor, Tensor]],
        input_ranges: Tensor,
        fine: tuple[int, ...],
        dtype: torch.dtype,
    ) -> None:
        """folded: the `UNet` with its normalisations folded. ranges: greatest outputs (`channel_ranges`). input_ranges
        (in,): the input is clipped to +- these; fine: its channels that get residual bits. dtype: of the last features
        and the head.
        """
        super().__init__()
        self.attention = folded.attention
        self.fine = fine
        self.register_buffer("input_ranges", input_ranges)
        levels = len(folded.encoder)
        steps = [(a / LARGEST, b / LARGEST) for a, b in ranges]
        outputs = [torch.uint8] * (2 * levels - 1)  # of each block, the encoder's first
        for index, output in ((levels - 1, torch.float32), (-1, dtype)):
            # The deepest features and the last stay in floating point, in their own unit.
            steps[index] = steps[index][0], torch.ones_like(steps[index][1])
            outputs[index] = output
        deepest = torch.cat([ranges[levels - 2][1], ranges[levels - 1][1]]) / MAX_STEPS
        inputs = [with_residual_bits(input_ranges / MAX_STEPS, fine), *(b for _, b in steps[: levels - 1]), deepest]
        inputs += [torch.cat([steps[levels - 2 - i][1], steps[levels - 1 + i][1]]) for i in range(1, levels - 1)]
        blocks = [*folded.encoder, *folded.decoder]
        convolutions = [(block[0], block[3]) for block in blocks]
        convolutions[0] = residual_bits_conv(convolutions[0][0], fine), convolutions[0][1]
        made = [
            nn.Sequential(
                Int8ConvReLU(first, given, step[0], torch.uint8, MIDDLE if index in (0, levels) else 0),
                Int8ConvReLU(second, *step, output),
            )
            for index, ((first, second), given, step, output) in enumerate(
                zip(convolutions, inputs, steps, outputs, strict=True)
            )
        ]
        self.encoder, self.decoder = nn.ModuleList(made[:levels]), nn.ModuleList(made[levels:])
        # Factors that bring the skip connection and the attention's output to the steps of their joint tensor.
        skips = steps[levels - 2][1]
        self.register_buffer("deepest", torch.cat([skips, torch.ones(len(deepest) - len(skips))]) / deepest)
        self.head = folded.head.to(dtype)

    def joined(self, parts: list[Tensor]) -> Tensor:
        """Concatenate channels (B,?,H,W) float32 -> (B,C,H,W) uint8; then come the residual bits of the fine ones."""
        images = [image for part in parts for image in part.unbind(dim=1)]
        per_unit = (MAX_STEPS / self.input_ranges).tolist()
        for channel in self.fine:
            steps = images[channel] * per_unit[channel]
            images.append(RESIDUAL_STEPS * (steps - (steps + 0.5).floor_().clamp_(-MIDDLE, MAX_STEPS)))
            per_unit.append(1)
        while len(images) % WORD:  # padding; its weights are zero
            images.append(images[-1])
            per_unit.append(0)
        return words_of(images, per_unit)

    def forward(self, x: Tensor) -> Tensor:
        skips = []
        for level, block in enumerate(self.encoder):
            x = block(_halved(x) if level else x)
            skips.append(x)
        x = F.interpolate(self.attention(skips.pop()), scale_factor=2, mode="bilinear", align_corners=False)
        both = torch.cat([skips.pop().float(), x], dim=1) * self.deepest.view(1, -1, 1, 1)
        x = both.add_(MIDDLE + 0.5).clamp_(0, LARGEST).to(torch.uint8, memory_format=torch.channels_last)
        x = self.decoder[0](x)
        for block in list(self.decoder)[1:]:
            x = block(beside_doubled(skips.pop(), x))
        return self.head(x)


def with_residual_bits(steps: Tensor, fine: tuple[int, ...]) -> Tensor:
    """Quantization steps (in,) of the input -> those of the input, of its residual bits and of the padding."""
    steps = torch.cat([steps, steps[list(fine)] / RESIDUAL_STEPS])
    return F.pad(steps, (0, -len(steps) % WORD), value=1)


def residual_bits_conv(conv: nn.Conv2d, fine: tuple[int, ...]) -> nn.Conv2d:
    """The convolution with the fine channels' weights repeated for their residual bits, and zeros for the padding."""
    made = copy.deepcopy(conv)
    weight = torch.cat([conv.weight, conv.weight[:, list(fine)]], dim=1)
    weight = F.pad(weight, (0, 0, 0, 0, 0, -weight.shape[1] % WORD))
    made.weight, made.in_channels = nn.Parameter(weight, requires_grad=False), weight.shape[1]
    return made


class Int8ConvReLU(nn.Module):
    """Convolution and ReLU of uint8 (B,in,H,W) -> (B,out,H,W) of `dtype`, in steps of `outputs` (out,)."""

    scale: Tensor
    zero: Tensor
    weight: Tensor
    bias: Tensor

    def __init__(
        self, conv: nn.Conv2d, inputs: Tensor, outputs: Tensor, dtype: torch.dtype, zero_point: int = 0
    ) -> None:
        """inputs (in,), outputs (out,): quantization step of each channel; zero_point: the integer that is zero in the
        input."""
        super().__init__()
        weight = conv.weight.detach().float() * inputs.view(1, -1, 1, 1) / outputs.view(-1, 1, 1, 1)
        scale = (weight.abs().amax(dim=(1, 2, 3)) / 127).clamp_min(1e-12)
        integers = (weight / scale.view(-1, 1, 1, 1)).round().to(torch.int8)
        self.register_buffer("scale", scale)
        self.register_buffer("zero", torch.zeros(len(scale), dtype=torch.int32))
        self.register_buffer("weight", integers.contiguous(memory_format=torch.channels_last))
        assert conv.bias is not None, "a folded convolution has a bias"
        self.register_buffer("bias", conv.bias.detach().float() / outputs)
        self.dtype, self.zero_point = dtype, zero_point
        self._shape: Any = [list(conv.stride), list(conv.padding), list(conv.dilation), conv.groups]
        self._layouts = Layouts()

    def forward(self, x: Tensor) -> Tensor:
        weight = self._layouts.of(x, self._laid_out)
        given = x, 1.0, self.zero_point, weight, self.scale, self.zero, self.bias, *self._shape
        return torch.ops.onednn.qconv_pointwise(*given, 1.0, 0, self.dtype, "relu", [], "")

    def _laid_out(self, shape: list[int]) -> Tensor:
        return torch.ops.onednn.qconv_prepack(self.weight, self.scale, 1.0, self.zero_point, *self._shape, shape)


def channel_ranges(unet: UNet) -> list[tuple[Tensor, Tensor]]:
    """Ranges (C,) of channels after the first and the second ReLU of each encoder block, then of each decoder block.

    unet: with its batch normalisations, not folded.
    """
    blocks = [*unet.encoder, *unet.decoder]
    return [(_range(block[1]), _range(block[4])) for block in blocks]


def _range(norm: nn.BatchNorm2d) -> Tensor:
    mean, deviation = norm.bias.detach().float(), norm.weight.detach().float().abs()
    return (mean + DEVIATIONS * deviation).clamp_min(1e-3)  # a channel that is never above zero has a step all the same


def _halved(x: Tensor) -> Tensor:
    """2x2 max pooling of uint8 in channels_last, which PyTorch's own does not support."""
    rows = torch.maximum(x[..., ::2, :], x[..., 1::2, :])
    return torch.maximum(rows[..., ::2], rows[..., 1::2])
