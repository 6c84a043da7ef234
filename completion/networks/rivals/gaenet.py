"""GAENet: "Depth completion using geometry-aware embedding", Du et al., ICRA 2022 (the paper's [22]).

The sparse points become a 3-D point cloud; a dynamic graph network (DGCNN, Wang et al., TOG 2019) describes each point
by its neighbours in space; the descriptions go back to the points' pixels, and two ERFNet encoders (Romera et al.,
T-ITS 2018) with a common decoder turn image and point map into depth. The released code does not run (a stray token
inside DGCNN, a trainer that imports a missing class, a fixed CUDA device); this follows its layers with these changes:

- The extra channel of the point map is the point's depth. As released it is index 1, the *y* coordinate; the option
  `coordinate="y"` brings that back.
- Any number of points for each image of a batch, none included: points of a batch are packed as rows, so that batch
  normalisation counts every point once, and an image with fewer than k points repeats its nearest.
- From scratch, without the pretrained ERFNet and DGCNN.
"""

from dataclasses import dataclass
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from completion.networks.padding import pad_to_multiple
from haustra.core.errors import CompletionError

STRIDE = 8
EDGE_WIDTHS = (64, 64, 128, 256)
FUSED = 64


def back_project(depth: Tensor, pixels: Tensor, intrinsics: Tensor) -> Tensor:
    """Points (M,3) as x, y, z of the camera, in the unit of the depth.

    depth (M,); pixels (M,3) = image, row, column; intrinsics (B,4) = fx, fy, cx, cy in pixels, where the centre of the
    top-left pixel is (0.5, 0.5).
    """
    fx, fy, cx, cy = intrinsics.to(depth)[pixels[:, 0]].unbind(dim=1)
    x = (pixels[:, 2] + 0.5 - cx) / fx * depth
    y = (pixels[:, 1] + 0.5 - cy) / fy * depth
    return torch.stack([x, y, depth], dim=1)


@torch.no_grad()
def nearest_rows(features: Tensor, counts: list[int], k: int) -> Tensor:
    """Indices (M,k) of the k nearest rows of features (M,C) in the same image, itself included.

    The rows of an image are adjacent and counts[b] many. With fewer than k of them the nearest is repeated, which
    leaves a maximum over the neighbours as it is.
    """
    found, start = [], 0
    for count in counts:
        own = features[start : start + count]
        for rows in own.split(1024):  # a full distance matrix of a dense depth map would not fit in memory
            index = torch.cdist(rows, own).topk(min(k, count), largest=False).indices + start
            found.append(torch.cat([index, index[:, :1].expand(-1, k - index.shape[1])], dim=1))
        start += count
    return torch.cat(found)


class EdgeConv(nn.Module):
    """max over neighbours j of LeakyReLU(BN(W [f_j - f_i, f_i])), (M,in) -> (M,out) (DGCNN's EdgeConv)."""

    def __init__(self, in_channels: int, out_channels: int) -> None:
        super().__init__()
        self.linear = nn.Linear(2 * in_channels, out_channels, bias=False)
        self.norm = nn.BatchNorm1d(out_channels)

    def forward(self, features: Tensor, neighbours: Tensor) -> Tensor:
        centre = features[:, None].expand(-1, neighbours.shape[1], -1)
        edges = torch.cat([features[neighbours] - centre, centre], dim=2)
        lifted = self.norm(self.linear(edges).flatten(0, 1)).view(*neighbours.shape, -1)
        return F.leaky_relu(lifted, 0.2).amax(dim=1)


class PointEmbedding(nn.Module):
    """The geometric encoding of a point cloud, (M,3) -> (M,features).

    The graph is rebuilt from the features before each of the four EdgeConvs; their outputs are joined, reduced to 64,
    and pooled by maximum over groups of 64/features *channels*, as released.
    """

    def __init__(self, features: int = 16, k: int = 9) -> None:
        super().__init__()
        self.features = features
        self.k = k
        self.edges = nn.ModuleList(EdgeConv(a, b) for a, b in zip((3, *EDGE_WIDTHS[:-1]), EDGE_WIDTHS, strict=True))
        self.fuse = nn.Linear(sum(EDGE_WIDTHS), FUSED, bias=False)
        self.norm = nn.BatchNorm1d(FUSED)

    def forward(self, points: Tensor, counts: list[int]) -> Tensor:
        x, levels = points, []
        for edge in self.edges:
            x = edge(x, nearest_rows(x, counts, self.k))
            levels.append(x)
        fused = F.leaky_relu(self.norm(self.fuse(torch.cat(levels, dim=1))), 0.2)
        return fused.view(len(points), self.features, -1).amax(dim=2)


class Down(nn.Module):
    """ERFNet's downsampler: strided 3x3 convolution beside a max-pool, (B,in,H,W) -> (B,out,H/2,W/2)."""

    def __init__(self, in_channels: int, out_channels: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(in_channels, out_channels - in_channels, 3, stride=2, padding=1)
        self.norm = nn.BatchNorm2d(out_channels, eps=1e-3)

    def forward(self, x: Tensor) -> Tensor:
        return F.relu(self.norm(torch.cat([self.conv(x), F.max_pool2d(x, 2)], dim=1)))


class NonBottleneck1d(nn.Module):
    """ERFNet's residual block of factorised 3x3 convolutions, the second pair dilated; the shape stays."""

    def __init__(self, channels: int, dropout: float = 0.0, dilation: int = 1) -> None:
        super().__init__()

        def tall_then_wide(d: int) -> list[nn.Module]:
            tall = nn.Conv2d(channels, channels, (3, 1), padding=(d, 0), dilation=(d, 1))
            wide = nn.Conv2d(channels, channels, (1, 3), padding=(0, d), dilation=(1, d))
            return [tall, nn.ReLU(), wide, nn.BatchNorm2d(channels, eps=1e-3)]

        self.branch = nn.Sequential(*tall_then_wide(1), nn.ReLU(), *tall_then_wide(dilation), nn.Dropout2d(dropout))

    def forward(self, x: Tensor) -> Tensor:
        return F.relu(x + self.branch(x))


class Encoder(nn.Module):
    """ERFNet's encoder, (B,in,H,W) -> its maps at 1/2 (base), 1/4 (2 base) and 1/8 (4 base)."""

    def __init__(self, in_channels: int, base: int) -> None:
        super().__init__()
        middle = [NonBottleneck1d(2 * base, 0.03) for _ in range(5)]
        deep = [NonBottleneck1d(4 * base, 0.3, dilation) for _ in range(2) for dilation in (2, 4, 8, 16)]
        self.levels = nn.ModuleList(
            [
                Down(in_channels, base),
                nn.Sequential(Down(base, 2 * base), *middle),
                nn.Sequential(Down(2 * base, 4 * base), *deep),
            ]
        )

    def forward(self, x: Tensor) -> list[Tensor]:
        maps = []
        for level in self.levels:
            x = level(x)
            maps.append(x)
        return maps


def _up(in_channels: int, out_channels: int) -> nn.ConvTranspose2d:
    return nn.ConvTranspose2d(in_channels, out_channels, 3, stride=2, padding=1, output_padding=1)


class JointDecoder(nn.Module):
    """Maps of both encoders -> depth (B,1,H,W): the image's maps are added, the points' are concatenated."""

    def __init__(self, base: int) -> None:
        super().__init__()
        pairs = [(8 * base, 2 * base), (4 * base, base)]
        self.ups = nn.ModuleList(nn.Sequential(_up(a, b), nn.BatchNorm2d(b, eps=1e-3), nn.ReLU()) for a, b in pairs)
        self.blocks = nn.ModuleList(nn.Sequential(NonBottleneck1d(b), NonBottleneck1d(b)) for _, b in pairs)
        self.head = _up(2 * base, 1)

    def forward(self, image: list[Tensor], points: list[Tensor]) -> Tensor:
        x = image[2]
        for level, up, block in zip((1, 0), self.ups, self.blocks, strict=True):
            x = block(up(torch.cat([x, points[level + 1]], dim=1)) + image[level])
        return self.head(torch.cat([x, points[0]], dim=1))


@dataclass(frozen=True)
class GAENetConfig:
    """Published: base 32, 16 features, k = 9, 500 points in training."""

    base: int = 32  # channels at half resolution
    features: int = 16  # of a point; divides 64
    k: int = 9
    max_points: int = 500  # of an image while training, drawn at random (torch's own generator); evaluation takes all
    coordinate: Literal["z", "y"] = "z"

    def __post_init__(self) -> None:
        if self.features < 1 or FUSED % self.features or self.features + 1 >= self.base:
            raise CompletionError(
                f"GAENet's features must divide {FUSED} and stay below base - 1, got {self.features} for {self.base}"
            )
        if self.k < 1 or self.coordinate not in ("z", "y"):
            raise CompletionError(f"GAENet takes k >= 1 and a coordinate z or y, got {self.k} and '{self.coordinate}'")


class GAENet(nn.Module):
    """The whole network: unit of the sparse depth in, same unit out."""

    waits_for_gpu = True  # the number of points is a shape

    def __init__(self, config: GAENetConfig | None = None) -> None:
        super().__init__()
        self.config = config or GAENetConfig()
        self.embedding = PointEmbedding(self.config.features, self.config.k)
        self.image_encoder = Encoder(3, self.config.base)
        self.point_encoder = Encoder(self.config.features + 1, self.config.base)
        self.decoder = JointDecoder(self.config.base)
        for module in self.modules():
            if isinstance(module, (nn.Conv2d, nn.ConvTranspose2d, nn.Linear)):
                nn.init.kaiming_normal_(module.weight)

    def point_map(self, sparse_depth: Tensor, intrinsics: Tensor) -> Tensor:
        """sparse_depth (B,1,H,W), intrinsics (B,4) -> features and one coordinate at the points (B,features+1,H,W)."""
        pixels = self._choose(sparse_depth[:, 0] > 0)
        image, row, column = pixels.unbind(dim=1)
        points = back_project(sparse_depth[image, 0, row, column], pixels, intrinsics)
        counts = torch.bincount(image, minlength=len(sparse_depth)).tolist()
        # Batch normalisation has no variance of a single point to learn from.
        if len(points) > (1 if self.training else 0):
            features = self.embedding(points, [count for count in counts if count])
        else:
            features = points.new_zeros(len(points), self.config.features)
        coordinate = points[:, 2:] if self.config.coordinate == "z" else points[:, 1:2]
        batch, _, height, width = sparse_depth.shape
        canvas = points.new_zeros(batch, height, width, self.config.features + 1)
        return canvas.index_put((image, row, column), torch.cat([features, coordinate], dim=1)).permute(0, 3, 1, 2)

    def _choose(self, known: Tensor) -> Tensor:
        """known (B,H,W) -> pixels (M,3) as image, row, column, image by image."""
        pixels = known.nonzero()
        if not self.training:
            return pixels
        chosen = []
        for image in range(len(known)):
            own = pixels[pixels[:, 0] == image]
            chosen.append(own[torch.randperm(len(own))[: self.config.max_points]] if len(own) else own)
        return torch.cat(chosen)

    def forward(self, rgb: Tensor, sparse_depth: Tensor, intrinsics: Tensor | None = None) -> Tensor:
        """rgb (B,3,H,W) in [0,1], sparse_depth (B,1,H,W) with 0 = none, intrinsics (B,4) fx fy cx cy in pixels
        -> depth (B,1,H,W)."""
        if intrinsics is None:
            raise CompletionError("GAENet works on 3-D points: give it intrinsics (B,4) as fx, fy, cx, cy in pixels")
        height, width = rgb.shape[2:]
        # float32 whatever the autocast: neighbours are found by differences of coordinates.
        with torch.autocast(rgb.device.type, enabled=False):
            points = self.point_map(pad_to_multiple(sparse_depth.float(), STRIDE), intrinsics)
        image_maps = self.image_encoder(pad_to_multiple(rgb, STRIDE))
        return self.decoder(image_maps, self.point_encoder(points))[..., :height, :width]
