"""MSCSA-Net for structure from motion, whose depth has no unit and whose points are few, noisy and clustered.

Log depth is relative to the median of the sparse points, so that k times the input gives k times the output. The second
output is the predicted error. The U-Net works at half resolution on four pixels folded into channels: as many pixels
at a third of the cost.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from completion.networks.channel_attention import StructureAwareness
from completion.networks.cpu.fused_conv import can_fuse, fuse_convolutions
from completion.networks.cpu.int8_unet import Int8UNet, channel_ranges
from completion.networks.cpu.numba_mscsa import COMPILED, CompiledAnchor
from completion.networks.cpu.numba_normalized_conv import LinearConfidence
from completion.networks.mscsa import UNet
from completion.networks.mscsa_sfm_kernels import (
    INPUT_RANGES,
    INPUTS,
    LOG_RANGE,
    NCONV_DEPTH_CHANNEL,
    PLAIN,
    RECURRENT_INPUTS,
    STRIDE,
    Anchor,
    double,
    log_of_confidence,
)
from completion.networks.normalized_conv import MultiScaleConfidence
from completion.networks.padding import pad_to_multiple
from completion.networks.precision import PRECISIONS, has_fast_bfloat16
from completion.networks.protocol import GRID, Estimate, SampleGrid
from completion.networks.recurrence import self_conditioned_input
from completion.networks.recurrent_norm import add_recurrent_norm, fold_batch_norm, set_recurrent
from haustra.core.errors import CompletionError


@dataclass(frozen=True)
class ScaleInvariantConfig:
    """Size of `ScaleInvariantMSCSANet`, switch of its last stage, and iterations in training."""

    width: int = 32  # channels of the first level, at half resolution; 32 gives 3 M parameters
    msc_levels: int = 4  # at half resolution: +-180 px, since points from SfM leave large holes
    anchor: bool = True  # correct the sum towards the points (`Anchor`)
    iterations: int = 1  # most that it was trained for; with more than one the U-Net has more input channels

    def __post_init__(self) -> None:
        if not 1 <= self.msc_levels <= 4 or self.width < 1 or self.iterations < 1:
            sizes = f"{self.width}, {self.iterations} and {self.msc_levels}"
            raise CompletionError(f"width and iterations must be positive and msc_levels 1 to 4, got {sizes}")


class ScaleInvariantMSCSANet(nn.Module):
    """MSC + U-Net + SA on median-normalised log depth, with a predicted error per pixel.

    log depth = MSC's dense estimate + the U-Net's residual + the points' correction of that sum (`Anchor`). The second
    output is log b, b the scale of a Laplace distribution of the log-depth error: a relative error.

    Recurrent iterations: the last estimate joins the points of MSC (`self_conditioned_input`) and is an input of the
    U-Net, beside the measured points alone; only measured points correct the sum.
    """

    precisions = PRECISIONS
    stride = STRIDE

    def __init__(self, config: ScaleInvariantConfig | None = None) -> None:
        super().__init__()
        self.config = config or ScaleInvariantConfig()
        self.msc = MultiScaleConfidence(self.config.msc_levels)
        attention = StructureAwareness(similarity="mean", learned_gain=True)
        widths = tuple(factor * self.config.width for factor in (1, 2, 4, 6, 6))
        inputs = INPUTS + (RECURRENT_INPUTS if self.config.iterations > 1 else 0)
        self.unet = UNet(inputs, 4 * 2 + 1, widths, attention)
        if self.config.iterations > 1:
            add_recurrent_norm(self.unet)
        self.anchor = Anchor(self.config.msc_levels) if self.config.anchor else None
        self.kernels = PLAIN

    def forward(
        self, rgb: Tensor, log_sparse: Tensor, trust: Tensor, last: Estimate | None = None, grid: SampleGrid = GRID
    ) -> Estimate:
        """rgb (B,3,H,W) in [0,1]; log_sparse (B,1,H,W) = log(depth / median), 0 where trust is 0; trust (B,1,H,W)
        in [0,1], 0 = no point -> log(depth / median) and log b, both (B,1,H,W) float32.

        last: the estimate of the iteration before; grid: pixels at which that joins the points. CompletionError if the
        network was not trained for it.
        """
        return self.iterate(self.prepare(rgb), log_sparse, trust, last, grid)

    def prepare(self, rgb: Tensor) -> Tensor:
        """Image (B,3,H,W), uint8 or in [0,1] -> (B,16,h,w), the U-Net's channels of it (`image_inputs`)."""
        return self.kernels.image_inputs(rgb)

    def iterate(
        self, image: Tensor, log_sparse: Tensor, trust: Tensor, last: Estimate | None = None, grid: SampleGrid = GRID
    ) -> Estimate:
        """`forward` with the image as `prepare` returns it."""
        if last is not None and self.config.iterations == 1:
            raise CompletionError("this network was trained for one iteration, and cannot take an estimate of its own")
        set_recurrent(self.unet, last is not None)
        height, width = log_sparse.shape[2:]
        unpadded = log_sparse.float(), trust.float()
        log_sparse, trust = (pad_to_multiple(x, STRIDE) for x in unpadded)
        with torch.autocast(image.device.type, enabled=False):
            points = measured = self.kernels.halve(log_sparse, trust)
            if last is not None:  # it joins before padding, so that the margin stays without points
                joined = self_conditioned_input(*unpadded, last, grid)
                points = self.kernels.halve(*(pad_to_multiple(x, STRIDE) for x in joined))
            coarse_depth, confidence = self.msc(*points)
            nconv_depth = double(coarse_depth)
            channels = [image, coarse_depth, log_of_confidence(confidence), *points]
            if last is not None:
                log_depth, log_error = (pad_to_multiple(x.float(), STRIDE, repeat_edge=True) for x in last)
                channels += [self.kernels.recurrent_inputs(log_depth, log_error, nconv_depth), *measured]
            elif self.config.iterations > 1:  # zeros, which cost a hundredth to convolve
                channels.append(torch.zeros_like(coarse_depth).expand(-1, RECURRENT_INPUTS, -1, -1))
        # The U-Net of an inference copy may be in lower precision; all else stays in float32.
        out = self.unet(self.unet.joined(channels)).float()
        log_depth, log_error = self.kernels.unfold(out, nconv_depth)
        if self.anchor is not None:
            log_depth = log_depth + self.anchor(log_depth, log_error, log_sparse, trust, out[:, 8:])
        log_depth = log_depth.clamp(-LOG_RANGE, LOG_RANGE)
        return Estimate(log_depth[..., :height, :width], log_error[..., :height, :width])

    def folded(self, recurrent: bool) -> "ScaleInvariantMSCSANet":
        """An evaluation copy, each batch normalisation folded into the convolution before it."""
        return fold_batch_norm(self, recurrent)

    def for_device(self, device: torch.device, precision: str, recurrent: bool) -> "ScaleInvariantMSCSANet":
        """The folded copy on a device, its U-Net's convolutions in int8, bf16 or fp32; all else stays in float32."""
        copy = self.folded(recurrent)
        if precision == "bf16":
            for part in (copy.unet.encoder, copy.unet.decoder, copy.unet.head):
                part.to(torch.bfloat16)
        copy = copy.to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        if device.type == "cpu":
            copy._for_cpu(precision, self.unet)
        return copy

    def _for_cpu(self, precision: str, trained: UNet) -> None:
        """Use compiled loops and int8 or fused convolutions, in place, on a folded copy of the network of `trained`."""
        self.msc = LinearConfidence(self.msc)  # type: ignore[assignment]
        self.kernels = COMPILED
        if self.anchor is not None:
            self.anchor = CompiledAnchor(self.anchor)  # type: ignore[assignment]
        half = can_fuse(torch.bfloat16)
        if precision == "int8":
            dtype = torch.bfloat16 if half and has_fast_bfloat16(torch.device("cpu")) else torch.float32
            ranges = torch.tensor(INPUT_RANGES[0] + (INPUT_RANGES[1] if self.config.iterations > 1 else ()))
            fine = (NCONV_DEPTH_CHANNEL,)
            self.unet = Int8UNet(self.unet, channel_ranges(trained), ranges, fine, dtype)  # type: ignore[assignment]
        elif precision == "bf16" and half:
            fuse_convolutions(self.unet)  # in float32 it gains little
