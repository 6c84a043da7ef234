"""What `ScaleInvariantMSCSANet` does around its U-Net: images, points and estimates to half resolution and back.

Plain PyTorch, for training and export; `completion.networks.cpu.numba_mscsa` has the same as compiled loops.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from completion.networks.normalized_conv import MultiScaleConfidence
from completion.networks.padding import pad_to_multiple

STRIDE = 32  # px; half resolution, then four halvings of the U-Net and of both confidence pyramids
LEAST_TRUST = 1e-12  # division guard: sum of a 2x2 block's trust
LOG_RANGE = 4.0  # |log(depth / median)| is kept below this: a colon spans 3 mm to 150 mm around 25 mm
LOG_ERROR_RANGE = (-6.0, 1.0)  # of the predicted log Laplace scale: relative errors of 0.25 % to 270 %
# Channels of the U-Net's input in every iteration, and those that recurrent networks have besides.
INPUTS, RECURRENT_INPUTS = 4 * 4 + 4, 4 + 1 + 2
# Greatest absolute values of those channels, at which int8 clips: colours - 0.5, log brightness, MSC's log depth and
# log confidence, the points' log depth and trust; last log depth minus MSC's, last log error / 6, measured points.
# Up to a tenth of MSC's depth is clipped in tubes 150 mm long, where depth was no better with 3 or 4 instead of 2.
INPUT_RANGES = (*12 * [0.5], *4 * [math.log(256)], 2.0, 1.0, 2.0, 1.0), (*4 * [1.0], 1.0, 2.0, 1.0)
NCONV_DEPTH_CHANNEL = 16  # index of MSC's log depth, which needs more than 8 bits


class Kernels(NamedTuple):
    """The functions of one iteration around its U-Net: `PLAIN`, or compiled loops (`cpu.numba_mscsa.COMPILED`)."""

    image_inputs: Callable[[Tensor], Tensor]
    halve: Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
    recurrent_inputs: Callable[[Tensor, Tensor, Tensor], Tensor]
    unfold: Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]


def image_inputs(rgb: Tensor) -> Tensor:
    """Image (B,3,H,W), uint8 or float in [0,1] -> colours and log brightness of four pixels each, (B,16,h,w) at half
    resolution, after padding to a multiple of `STRIDE`."""
    if rgb.dtype == torch.uint8:
        rgb = rgb.float() / 255
    with torch.autocast(rgb.device.type, enabled=False):
        # The edge is repeated: a black margin would read as infinitely far.
        rgb = pad_to_multiple(rgb.float(), STRIDE, repeat_edge=True)
        red, green, blue = rgb.split(1, dim=1)
        # The lamp sits at the camera, so log brightness is about -2 log depth + reflectance.
        log_brightness = torch.log(torch.maximum(torch.maximum(red, green), blue) + 1 / 255)
        return F.pixel_unshuffle(torch.cat([rgb - 0.5, log_brightness], dim=1), 2)


def log_of_confidence(confidence: Tensor) -> Tensor:
    """Log of MSC's confidence, which spans eight decades, mapped to [0,1] for the U-Net."""
    # Not log(c + 1e-8): the ONNX exporter drops an addend that small, and far from every point, c is exactly zero.
    return torch.log1p(1e8 * confidence.clamp_min(0)) / (8 * math.log(10))


def recurrent_inputs(log_depth: Tensor, log_error: Tensor, nconv_depth: Tensor) -> Tensor:
    """The last estimate minus MSC's depth, and its error, as the U-Net's channels in recurrent iterations.

    (B,1,H,W) each -> (B,5,H/2,W/2): four pixels' differences, mean log error over its least value."""
    off = F.pixel_unshuffle(log_depth - nconv_depth, 2)
    return torch.cat([off, F.avg_pool2d(log_error, 2) / -LOG_ERROR_RANGE[0]], dim=1)


def unfold(out: Tensor, nconv_depth: Tensor) -> tuple[Tensor, Tensor]:
    """The U-Net's output (B,9,H/2,W/2) and MSC's estimate (B,1,H,W) -> log depth and log error, (B,1,H,W)."""
    residual, log_error = F.pixel_shuffle(out[:, :8], 2).split(1, dim=1)
    return nconv_depth + residual, log_error.clamp(*LOG_ERROR_RANGE)


class Anchor(nn.Module):
    """Correction of dense log depth towards the points: their residuals, densified by a second MSC, times a gate.

    A residual is weighted by Cauchy's function of its ratio to the predicted error, since most points far off are
    outliers. The gate, one of the U-Net's outputs, weights the correction of each pixel.
    """

    def __init__(self, levels: int) -> None:
        super().__init__()
        self.msc = MultiScaleConfidence(levels)
        self.log_tolerance = nn.Parameter(torch.tensor(1.0))  # in predicted errors; starts at e

    def forward(self, log_depth: Tensor, log_error: Tensor, log_sparse: Tensor, trust: Tensor, gate: Tensor) -> Tensor:
        """Dense log depth, its log error, log_sparse and trust (B,1,H,W), gate logits (B,1,H/2,W/2) -> (B,1,H,W)."""
        with torch.autocast(log_depth.device.type, enabled=False):
            off = torch.where(trust > 0, log_sparse - log_depth, torch.zeros_like(log_depth))
            surprise = off * torch.exp(-log_error - self.log_tolerance)
            correction, _ = self.msc(*halve_points(off, trust / (1 + surprise * surprise)))
            return double(torch.sigmoid(gate) * correction)


def halve_points(values: Tensor, trust: Tensor) -> tuple[Tensor, Tensor]:
    """Points (B,1,H,W), even sides -> (B,1,H/2,W/2): trust-weighted mean of each 2x2 block, its greatest trust."""
    (a, b, c, d), (w, x, y, z) = _quarters(trust), _quarters(values * trust)  # forward twice as fast as pooling
    most = torch.maximum(torch.maximum(a, b), torch.maximum(c, d))
    return (w + x + y + z) / (a + b + c + d).clamp_min(LEAST_TRUST), most


def _quarters(image: Tensor) -> list[Tensor]:
    """The four pixels of each 2x2 block: (...,H,W) -> four of (...,H/2,W/2)."""
    return [image[..., row::2, column::2] for row in (0, 1) for column in (0, 1)]


def double(coarse: Tensor) -> Tensor:
    """Bilinear upsampling by two, (B,C,h,w) -> (B,C,2h,2w)."""
    return F.interpolate(coarse, scale_factor=2, mode="bilinear", align_corners=False)


PLAIN = Kernels(image_inputs, halve_points, recurrent_inputs, unfold)
