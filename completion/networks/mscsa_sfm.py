"""MSCSA-Net for structure from motion, whose depth has no unit and whose points are few, noisy and clustered.

The network works on log depth divided by the median of the sparse points, so that k times the input gives k times the
output, and it predicts its own error. It sees the picture at half resolution, four pixels folded into channels: the
same pixels at a third of the cost.
"""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from completion.networks.channel_attention import StructureAwareness
from completion.networks.mscsa import UNet
from completion.networks.normalized_conv import MultiScaleConfidence
from completion.networks.padding import pad_to_multiple
from completion.networks.recurrence import GRID, Estimate, Grid, with_own_points
from completion.networks.recurrent_norm import give_looks, set_look
from haustra.core.errors import CompletionError

STRIDE = 32  # half resolution, then four halvings of the U-Net and of both confidence pyramids
LEAST_TRUST = 1e-12  # of a block of pixels, below which the mean of its points tends to zero
LOG_RANGE = 4.0  # |log(depth / median)| is kept below this: a colon spans 3 mm to 150 mm around 25 mm
LOG_ERROR_RANGE = (-6.0, 1.0)  # of the predicted log Laplace scale: relative errors of 0.25 % to 270 %
INPUTS, OWN_INPUTS = 4 * 4 + 4, 4 + 1 + 2  # channels of the U-Net's input: of every look, and those of later looks
# How far those and these go: colours, log brightness, MSC's log depth and confidence, the points'; the last estimate
# against MSC's, its error, the measured points. In 8 bits what goes further is cut off: of MSC's depth
# up to a tenth in tubes 150 mm long, where depth was no better with a reach of 3 or 4.
REACHES = (*12 * [0.5], *4 * [math.log(256)], 2.0, 1.0, 2.0, 1.0), (*4 * [1.0], 1.0, 2.0, 1.0)
SPREAD = 16  # the channel of MSC's depth, of which 8 bits are too few


@dataclass(frozen=True)
class ScaleFreeConfig:
    """Size of `ScaleFreeMSCSANet`, the switch of its last stage, and how it was trained to be used."""

    width: int = 32  # channels of the first level, at half resolution; 32 gives 3 M parameters
    msc_levels: int = 4  # at half resolution: reach of +-180 px, since points from SfM leave large holes
    anchor: bool = True
    looks: int = 1  # most looks that it was trained for, see completion.feedback; more than one adds input channels

    def __post_init__(self) -> None:
        if not 1 <= self.msc_levels <= 4 or self.width < 1 or self.looks < 1:
            sizes = f"{self.width}, {self.looks} and {self.msc_levels}"
            raise CompletionError(f"width and looks must be positive and msc_levels 1 to 4, got {sizes}")

    def to_dict(self) -> dict[str, object]:
        return asdict(self)


class Steps(NamedTuple):
    """What a look does around its U-Net. `compiled_look` has the same as compiled loops, for inference on a CPU."""

    halve: Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
    own_inputs: Callable[[Tensor, Tensor, Tensor], Tensor]
    unfold: Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]


class ScaleFreeMSCSANet(nn.Module):
    """MSC + U-Net + SA on median-normalised log depth, with a predicted error per pixel.

    log depth = MSC's dense estimate + the U-Net's residual + what the points still say against their sum. The second
    output is log b, the scale of a Laplace distribution over the log-depth error, so b reads as a relative error.

    Trained for several looks it takes its last estimate too. MSC then starts from that; the U-Net is told which points
    were measured; and only those correct the sum.
    """

    def __init__(self, config: ScaleFreeConfig | None = None) -> None:
        super().__init__()
        self.config = config or ScaleFreeConfig()
        self.msc = MultiScaleConfidence(self.config.msc_levels)
        attention = StructureAwareness(similarity="mean", learned_gain=True)
        widths = tuple(factor * self.config.width for factor in (1, 2, 4, 6, 6))
        inputs = INPUTS + (OWN_INPUTS if self.config.looks > 1 else 0)
        self.unet = UNet(inputs, 4 * 2 + 1, widths, attention)
        if self.config.looks > 1:
            give_looks(self.unet)
        self.anchor = Anchor(self.config.msc_levels) if self.config.anchor else None
        self.steps = Steps(halve_points, own_inputs, unfold)

    def forward(
        self, rgb: Tensor, log_sparse: Tensor, trust: Tensor, last: Estimate | None = None, grid: Grid = GRID
    ) -> Estimate:
        """rgb (B,3,H,W) in [0,1]; log_sparse (B,1,H,W) = log(depth / median), 0 where trust is 0; trust (B,1,H,W)
        in [0,1], 0 = no point -> log(depth / median) and log b, both (B,1,H,W) float32.

        `last`: what the look before made of the same; `grid`: where that joins the points. CompletionError if the
        network was not trained for it.
        """
        return self.look(picture_inputs(rgb), log_sparse, trust, last, grid)

    def look(
        self, picture: Tensor, log_sparse: Tensor, trust: Tensor, last: Estimate | None = None, grid: Grid = GRID
    ) -> Estimate:
        """`forward` with what `picture_inputs` makes of the image, which all looks of a frame have in common."""
        if last is not None and self.config.looks == 1:
            raise CompletionError("this network was trained to look once, and cannot take an estimate of its own")
        set_look(self.unet, last is not None)
        height, width = log_sparse.shape[2:]
        unpadded = log_sparse.float(), trust.float()
        log_sparse, trust = (pad_to_multiple(x, STRIDE) for x in unpadded)
        with torch.autocast(picture.device.type, enabled=False):
            points = measured = self.steps.halve(log_sparse, trust)
            if last is not None:  # its points join before padding, since the margin has none
                joined = with_own_points(*unpadded, last, grid)
                points = self.steps.halve(*(pad_to_multiple(x, STRIDE) for x in joined))
            spread, confidence = self.msc(*points)
            whole_spread = double(spread)
            channels = [picture, spread, log_of_confidence(confidence), *points]
            if last is not None:
                log_depth, log_error = (pad_to_multiple(x.float(), STRIDE, repeat_edge=True) for x in last)
                channels += [self.steps.own_inputs(log_depth, log_error, whole_spread), *measured]
            elif self.config.looks > 1:  # zeros, which cost a hundredth to convolve
                channels.append(torch.zeros_like(spread).expand(-1, OWN_INPUTS, -1, -1))
        # A copy for inference may hold the U-Net in less than float32; everything else stays in that.
        out = self.unet(self.unet.joined(channels)).float()
        log_depth, log_error = self.steps.unfold(out, whole_spread)
        if self.anchor is not None:
            log_depth = log_depth + self.anchor(log_depth, log_error, log_sparse, trust, out[:, 8:])
        log_depth = log_depth.clamp(-LOG_RANGE, LOG_RANGE)
        return Estimate(log_depth[..., :height, :width], log_error[..., :height, :width])


def picture_inputs(rgb: Tensor) -> Tensor:
    """What the U-Net sees of a picture (B,3,H,W) in [0,1]: colours and log brightness of four pixels each, (B,16,h,w)
    at half resolution, after padding to a multiple of `STRIDE`."""
    with torch.autocast(rgb.device.type, enabled=False):
        # A black margin would read as infinitely far: the picture's edge is repeated instead.
        rgb = pad_to_multiple(rgb.float(), STRIDE, repeat_edge=True)
        red, green, blue = rgb.split(1, dim=1)
        # The lamp sits at the camera, so log brightness is about -2 log depth + reflectance.
        log_brightness = torch.log(torch.maximum(torch.maximum(red, green), blue) + 1 / 255)
        return F.pixel_unshuffle(torch.cat([rgb - 0.5, log_brightness], dim=1), 2)


def log_of_confidence(confidence: Tensor) -> Tensor:
    """MSC's confidence spans eight decades; the U-Net sees its logarithm, in [0, 1]."""
    # Not log(c + 1e-8): the ONNX exporter drops an addend that small, and where no point reaches, c is exactly zero.
    return torch.log1p(1e8 * confidence.clamp_min(0)) / (8 * math.log(10))


def own_inputs(log_depth: Tensor, log_error: Tensor, whole_spread: Tensor) -> Tensor:
    """What later looks give the U-Net besides which points were measured: the last estimate against MSC's, (B,1,H,W)
    all, and its error -> (B,5,H/2,W/2)."""
    off = F.pixel_unshuffle(log_depth - whole_spread, 2)
    return torch.cat([off, F.avg_pool2d(log_error, 2) / -LOG_ERROR_RANGE[0]], dim=1)


def unfold(out: Tensor, whole_spread: Tensor) -> tuple[Tensor, Tensor]:
    """The U-Net's output (B,9,H/2,W/2) and MSC's estimate (B,1,H,W) -> log depth and log error, (B,1,H,W)."""
    residual, log_error = F.pixel_shuffle(out[:, :8], 2).split(1, dim=1)
    return whole_spread + residual, log_error.clamp(*LOG_ERROR_RANGE)


class Anchor(nn.Module):
    """What points say against a dense estimate, spread from them by a second confidence pyramid.

    A point further off than the estimate's own predicted error allows counts for less (Cauchy's weight): most such
    points are outliers. The U-Net's gate says where to listen at all.
    """

    def __init__(self, levels: int) -> None:
        super().__init__()
        self.msc = MultiScaleConfidence(levels)
        self.log_tolerance = nn.Parameter(torch.tensor(1.0))  # in predicted errors; starts at e

    def forward(self, log_depth: Tensor, log_error: Tensor, log_sparse: Tensor, trust: Tensor, gate: Tensor) -> Tensor:
        """Dense estimate, its log error and the points, all (B,1,H,W), and gate logits at half size -> correction."""
        with torch.autocast(log_depth.device.type, enabled=False):
            off = torch.where(trust > 0, log_sparse - log_depth, torch.zeros_like(log_depth))
            surprise = off * torch.exp(-log_error - self.log_tolerance)
            correction, _ = self.msc(*halve_points(off, trust / (1 + surprise * surprise)))
            return double(torch.sigmoid(gate) * correction)


def halve_points(values: Tensor, trust: Tensor) -> tuple[Tensor, Tensor]:
    """Points (B,1,H,W) of even sides at half resolution: trust-weighted mean of each 2x2 block, its greatest trust."""
    (a, b, c, d), (w, x, y, z) = _quarters(trust), _quarters(values * trust)  # forward twice as fast as pooling
    most = torch.maximum(torch.maximum(a, b), torch.maximum(c, d))
    return (w + x + y + z) / (a + b + c + d).clamp_min(LEAST_TRUST), most


def _quarters(image: Tensor) -> list[Tensor]:
    """The four pixels of each 2x2 block, apart."""
    return [image[..., row::2, column::2] for row in (0, 1) for column in (0, 1)]


def double(coarse: Tensor) -> Tensor:
    """Bilinear upsampling by two."""
    return F.interpolate(coarse, scale_factor=2, mode="bilinear", align_corners=False)
