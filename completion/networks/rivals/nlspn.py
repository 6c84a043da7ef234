"""NLSPN: Non-Local Spatial Propagation Network, Park et al., ECCV 2020 (the paper's [19]).

A U-Net with a ResNet inside predicts an initial depth, its confidence and a guidance map. From the guidance, every
pixel gets eight neighbours at real-valued places and an affinity to each; eighteen steps then replace each depth by
the affinity-weighted mean of its neighbours. The released code calls a CUDA kernel (modulated deformable convolution)
for a step; here a step is one bilinear `grid_sample` of all eight neighbours.
"""

from dataclasses import dataclass
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from completion.networks.padding import pad_to_multiple
from completion.networks.rivals.resnet import out_widths, resnet_stages
from haustra.core.errors import CompletionError

Affinity = Literal["AS", "ASS", "TC", "TGASS"]
NEIGHBOURS = 8
STRIDE = 16


def normalise_affinity(raw: Tensor, kind: Affinity, scale: Tensor, confidence: Tensor | None) -> Tensor:
    """Raw affinities (B,8,H,W) -> ones that keep the propagation stable, same shape: the paper's four.

    AS: divided by the sum of magnitudes. ASS: only where that sum exceeds one. TC: tanh(raw) / scale with scale = 8.
    TGASS: tanh(raw) / scale with a learnt scale, then ASS. The confidence of each neighbour (B,8,H,W) multiplies in
    before the sums, so that where these stay below one, a doubtful neighbour leaves its share to the centre.
    """
    affinity = raw
    if kind in ("TC", "TGASS"):
        affinity = torch.tanh(raw) / (scale + 1e-8)
    if confidence is not None:
        affinity = affinity * confidence
    if kind == "TC":
        return affinity
    magnitude = affinity.abs().sum(dim=1, keepdim=True) + 1e-4
    return affinity / (magnitude if kind == "AS" else magnitude.clamp_min(1))


def sampling_grid(offsets: Tensor) -> Tensor:
    """Offsets (B,8,2,H,W) as (dy, dx) in pixels from the 3x3 window -> grid (B,8H,W,2) for `grid_sample`."""
    batch, _, _, height, width = offsets.shape
    moved = offsets + _window(offsets)
    y = moved[:, :, 0] + torch.arange(height, device=offsets.device, dtype=offsets.dtype).view(-1, 1)
    x = moved[:, :, 1] + torch.arange(width, device=offsets.device, dtype=offsets.dtype)
    # align_corners=False units, which a side of one pixel does not divide by zero.
    grid = torch.stack([(2 * x + 1) / width - 1, (2 * y + 1) / height - 1], dim=-1)
    return grid.view(batch, NEIGHBOURS * height, width, 2)


def _window(like: Tensor) -> Tensor:
    """(1,8,2,1,1) as (dy, dx): where a neighbour sits in a 3x3 window before its offset, row by row."""
    places = torch.arange(9, device=like.device)  # made there: a copy from the CPU would wait for it
    around = torch.cat([places[:4], places[5:]])
    return torch.stack([around // 3 - 1, around % 3 - 1], dim=1).to(like.dtype).view(1, NEIGHBOURS, 2, 1, 1)


def sample_neighbours(image: Tensor, grid: Tensor) -> Tensor:
    """Bilinear values of a (B,1,H,W) image at the eight neighbours, (B,8,H,W); pixels outside count as zero."""
    values = F.grid_sample(image, grid, mode="bilinear", padding_mode="zeros", align_corners=False)
    return values.view(len(image), NEIGHBOURS, *image.shape[2:])


class NonLocalPropagation(nn.Module):
    """The propagation layer; neighbours and affinities stay fixed over the steps."""

    def __init__(self, affinity: Affinity = "TGASS", steps: int = 18, gamma: float = 0.5) -> None:
        super().__init__()
        self.affinity = affinity
        self.steps = steps
        # 16 offsets, dy before dx for each neighbour, then 8 affinities. Zeros: it starts as the identity.
        self.predict = nn.Conv2d(NEIGHBOURS, 3 * NEIGHBOURS, 3, padding=1)
        nn.init.zeros_(self.predict.weight)
        nn.init.zeros_(self.predict.bias)  # type: ignore[arg-type]
        learnt = affinity == "TGASS"
        self.scale = nn.Parameter(torch.tensor(NEIGHBOURS * (gamma if learnt else 1.0)), requires_grad=learnt)

    def neighbourhood(self, guidance: Tensor, confidence: Tensor | None) -> tuple[Tensor, Tensor]:
        """guidance (B,8,H,W), confidence (B,1,H,W) or None -> grid (B,8H,W,2), affinities (B,8,H,W)."""
        batch, _, height, width = guidance.shape
        predicted = self.predict(guidance)
        grid = sampling_grid(predicted[:, : 2 * NEIGHBOURS].view(batch, NEIGHBOURS, 2, height, width))
        # The confidence of the neighbour that is averaged; the offsets get no gradient through it, as released.
        near = None if confidence is None else sample_neighbours(confidence, grid.detach())
        return grid, normalise_affinity(predicted[:, 2 * NEIGHBOURS :], self.affinity, self.scale, near)

    def forward(self, depth: Tensor, guidance: Tensor, confidence: Tensor | None = None) -> Tensor:
        """depth (B,1,H,W) -> propagated depth (B,1,H,W): d(p) <- a0 d(p) + sum_k a_k d(p_k), a0 = 1 - sum_k a_k."""
        grid, affinity = self.neighbourhood(guidance, confidence)
        centre = 1 - affinity.sum(dim=1, keepdim=True)
        for _ in range(self.steps):
            depth = centre * depth + (affinity * sample_neighbours(depth, grid)).sum(dim=1, keepdim=True)
        return depth


def _conv(in_channels: int, out_channels: int, stride: int = 1) -> nn.Sequential:
    """3x3 convolution, batch normalisation, LeakyReLU."""
    return nn.Sequential(
        nn.Conv2d(in_channels, out_channels, 3, stride, 1, bias=False),
        nn.BatchNorm2d(out_channels),
        nn.LeakyReLU(0.2),
    )


def _up(in_channels: int, out_channels: int) -> nn.Sequential:
    """3x3 transposed convolution that doubles the sides, batch normalisation, LeakyReLU."""
    return nn.Sequential(
        nn.ConvTranspose2d(in_channels, out_channels, 3, 2, 1, 1, bias=False),
        nn.BatchNorm2d(out_channels),
        nn.LeakyReLU(0.2),
    )


class Head(nn.Module):
    """A full-resolution branch: decoder and encoder features -> hidden -> out, linear at its end."""

    def __init__(self, base: int, hidden: int, out_channels: int) -> None:
        super().__init__()
        self.hidden = _conv(2 * base, hidden)
        self.out = nn.Conv2d(hidden + base, out_channels, 3, padding=1)

    def forward(self, decoded: Tensor, first: Tensor) -> Tensor:
        """decoded (B,2*base,H,W), first (B,base,H,W): the encoder's first map -> (B,out,H,W)."""
        return self.out(torch.cat([self.hidden(decoded), first], dim=1))


@dataclass(frozen=True)
class NLSPNConfig:
    """Published: 34 layers, base 64, 18 steps, TGASS, confidence, input points not re-inserted."""

    layers: int = 34  # or 18
    base: int = 64  # channels at full resolution
    steps: int = 18
    affinity: Affinity = "TGASS"
    gamma: float = 0.5  # TGASS's scale starts at 8 gamma
    use_confidence: bool = True
    preserve_input: bool = False

    def __post_init__(self) -> None:
        if self.layers not in (18, 34):
            raise CompletionError(f"NLSPN has 18 or 34 layers, not {self.layers}")
        if self.base < 4 or self.base % 4:
            raise CompletionError(f"NLSPN's base width must be a multiple of 4, got {self.base}")
        if self.affinity not in ("AS", "ASS", "TC", "TGASS"):
            raise CompletionError(f"NLSPN has no affinity '{self.affinity}'")


class NLSPN(nn.Module):
    """The whole network: unit of the sparse depth in, same unit out, never negative."""

    def __init__(self, config: NLSPNConfig | None = None) -> None:
        super().__init__()
        self.config = config or NLSPNConfig()
        base = self.config.base
        one, two, four, eight = out_widths(self.config.layers, base)
        self.from_rgb = nn.Sequential(nn.Conv2d(3, 3 * base // 4, 3, padding=1), nn.LeakyReLU(0.2))
        self.from_depth = nn.Sequential(nn.Conv2d(1, base // 4, 3, padding=1), nn.LeakyReLU(0.2))
        self.stages = resnet_stages(self.config.layers, base)
        self.deepest = _conv(eight, eight, stride=2)
        self.decoder = nn.ModuleList(
            [_up(eight, four), _up(four + eight, two), _up(two + four, one), _up(one + two, one)]
        )
        self.initial = Head(base, base, 1)
        self.guidance = Head(base, base, NEIGHBOURS)
        self.confidence = Head(base, base // 2, 1) if self.config.use_confidence else None
        self.propagation = NonLocalPropagation(self.config.affinity, self.config.steps, self.config.gamma)

    def predict(self, rgb: Tensor, sparse_depth: Tensor) -> tuple[Tensor, Tensor, Tensor | None]:
        """What the propagation starts from: initial depth (B,1,H,W), guidance (B,8,H,W), confidence (B,1,H,W)."""
        height, width = rgb.shape[2:]
        rgb, sparse_depth = pad_to_multiple(rgb, STRIDE), pad_to_multiple(sparse_depth, STRIDE)
        first = torch.cat([self.from_rgb(rgb), self.from_depth(sparse_depth)], dim=1)
        skips = [first]
        for stage in self.stages:
            skips.append(stage(skips[-1]))
        x = self.deepest(skips[-1])
        for block in self.decoder:
            x = torch.cat([block(x), skips.pop()], dim=1)
        # Cropped before the propagation, whose "outside counts as zero" must mean outside the image.
        initial = F.leaky_relu(self.initial(x, first), 0.2)[..., :height, :width]
        guidance = self.guidance(x, first)[..., :height, :width]
        confidence = self.confidence(x, first)[..., :height, :width].sigmoid() if self.confidence is not None else None
        return initial, guidance, confidence

    def forward(self, rgb: Tensor, sparse_depth: Tensor, intrinsics: Tensor | None = None) -> Tensor:
        """rgb (B,3,H,W) in [0,1], sparse_depth (B,1,H,W) with 0 = none -> depth (B,1,H,W); intrinsics unused."""
        initial, guidance, confidence = self.predict(rgb, sparse_depth)
        # float32 whatever the autocast: half precision places a neighbour of a wide image a pixel off.
        with torch.autocast(rgb.device.type, enabled=False):
            confidence = confidence.float() if confidence is not None else None
            depth = self.propagation(initial.float(), guidance.float(), confidence)
        if self.config.preserve_input:
            depth = torch.where(sparse_depth > 0, sparse_depth, depth)
        return depth.clamp_min(0)
