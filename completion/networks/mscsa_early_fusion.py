"""MSCSA-Net on the encoder-decoder of its source for normalised convolution, a reading of what the paper leaves open.

The paper's training settings are those of the released "early fusion" network of Eldesokey et al. (TPAMI 2020, the
paper's [25]), which is U-shaped too. The layer table is of that release; structure awareness (Fig. 3) is added to it
between encoder and decoder, and the raw sparse depth to the input (Fig. 2).
"""

from dataclasses import dataclass
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from completion.networks.channel_attention import StructureAwareness
from completion.networks.conv_blocks import start_by_he
from completion.networks.normalized_conv import MultiScaleConfidence
from completion.networks.padding import pad_to_multiple
from haustra.core.errors import CompletionError

MSC_STRIDE = 8  # px; three halvings of its pyramid
SLOPE = 0.2  # of the decoder's LeakyReLU, the output's too
BIAS = 0.01  # of every convolution at the start


@dataclass(frozen=True)
class EarlyFusionConfig:
    """Channels and switches of `EarlyFusionMSCSANet`."""

    width: int = 80  # channels of every level of the encoder; the decoder's follow from it
    widening: float = 1.0  # of `width`
    levels: int = 5  # strided convolutions, each halving the resolution; three or more
    use_msc: bool = True
    use_sa: bool = True
    confidence_last: bool = False  # MSC's confidence joins again before the last convolution too
    all_scales: bool = False  # the input has depth and confidence of MSC's coarser levels too, enlarged
    sparse_last: bool = True  # the raw sparse depth joins again before the last convolution
    gamma_beta: float = 10.0  # of MSC: Gamma(w) = log(1 + exp(beta w)) / beta; 1 as printed in the paper
    epsilon: float = 0.0  # of MSC: of the numerator of Eq. 2
    guard: float = 0.0  # of MSC: the epsilon that Eq. 1 adds to its denominator
    replaces: bool = False  # of MSC: Gamma(W) takes the place of W in each step, as released; else Eq. 3
    similar: bool = (
        False  # SA weighs like channels most, as the paper's words have it; else unlike ones, as its sources
    )
    learned_gain: bool = False  # SA's weight is learnt from zero (DANet); else one

    def __post_init__(self) -> None:
        if self.levels < 3:
            raise CompletionError(f"the early-fusion network has three levels or more, not {self.levels}")
        if (self.confidence_last or self.all_scales) and not self.use_msc:
            raise CompletionError("'confidence_last' and 'all_scales' are of MSC's output, and this network has none")


class EarlyFusionMSCSANet(nn.Module):
    """MSC, five strided 3x3 convolutions, SA, and five 3x3 convolutions after nearest enlarging; no normalisation. With
    fewer `levels` the coarsest are left out.

    Input: MSC's depth and confidence, RGB and the raw sparse depth (six channels); without MSC the four of RGB-SD. The
    raw sparse depth joins again before the last convolution. 484,923 parameters at the released width. What the paper
    means by features of its multi-scale module it does not say: `EarlyFusionConfig.confidence_last` and `all_scales`.
    """

    def __init__(self, config: EarlyFusionConfig | None = None) -> None:
        super().__init__()
        self.config = config or EarlyFusionConfig()
        width = round(self.config.width * self.config.widening)
        of_msc = (3, self.config.gamma_beta, self.config.epsilon, self.config.guard, self.config.replaces)
        self.msc = MultiScaleConfidence(*of_msc) if self.config.use_msc else None
        sign: Literal["similar", "distinct"] = "similar" if self.config.similar else "distinct"
        self.attention = (
            StructureAwareness("sum", self.config.learned_gain, sign) if self.config.use_sa else nn.Identity()
        )
        inputs, deeper = 4 + 2 * self.config.use_msc + 12 * self.config.all_scales, self.config.levels - 1
        self.encoder = nn.ModuleList(
            nn.Conv2d(channels, width, 3, stride=2, padding=1) for channels in (inputs, *[width] * deeper)
        )
        wide, narrow = 4 * width // 5, 2 * width // 5  # 64 and 32
        outputs = [wide] * (deeper - 2) + [narrow] * 2
        pairs = [(given + width, out) for given, out in zip([width, *outputs], outputs, strict=False)]
        self.decoder = nn.ModuleList(nn.Conv2d(a, b, 3, padding=1) for a, b in (*pairs, (narrow + self._joins_last, 1)))
        for conv in (*self.encoder, *self.decoder):
            start_by_he(conv, 0.0, BIAS)  # type: ignore[arg-type]  # for a ReLU, as released, the decoder's too

    @property
    def _joins_last(self) -> int:
        """Channels of the input that join again before the last convolution."""
        return self.config.sparse_last + self.config.confidence_last

    def forward(self, rgb: Tensor, sparse_depth: Tensor, intrinsics: Tensor | None = None) -> Tensor:
        """rgb (B,3,H,W) in [0,1], sparse_depth (B,1,H,W) with 0 = none -> depth (B,1,H,W), same unit; intrinsics
        unused."""
        height, width = rgb.shape[2:]
        stride = max(2**self.config.levels, MSC_STRIDE)
        rgb, sparse_depth = pad_to_multiple(rgb, stride), pad_to_multiple(sparse_depth, stride)
        channels = [sparse_depth, *self._dense(sparse_depth), rgb]
        x = torch.cat(channels, dim=1).contiguous(memory_format=torch.channels_last)
        first = 0 if self.config.sparse_last else 1
        skips = [x[:, first : first + self._joins_last]]  # in the same layout as the features
        for conv in self.encoder:
            x = F.relu(conv(x), inplace=True)
            skips.append(x)
        x = self.attention(skips.pop())
        for conv in self.decoder:
            x = F.interpolate(x, scale_factor=2, mode="nearest")
            x = F.leaky_relu(conv(torch.cat([x, skips.pop().to(x.dtype)], dim=1)), SLOPE, inplace=True)
        return x[..., :height, :width]

    def _dense(self, sparse_depth: Tensor) -> list[Tensor]:
        """MSC's channels, float32; its coarser levels enlarged by the nearest pixel."""
        if self.msc is None:
            return []
        with torch.autocast(sparse_depth.device.type, enabled=False):
            *coarse, fine = self.msc.scales(sparse_depth.float(), (sparse_depth > 0).float())
            depth, confidence = self.msc.project(*fine)
            if not self.config.all_scales:
                coarse = []
            enlarged = [F.interpolate(x, size=depth.shape[2:], mode="nearest") for level in coarse for x in level]
        return [confidence, depth, *enlarged]
