"""Multi-scale confidence (MSC): normalised convolution of sparse depth, paper section II-B.

Normalised convolution (Eqs. 1 and 2; Eldesokey et al., TPAMI 2020, the paper's [25]) averages the *known*
neighbours of a pixel with a non-negative learnt kernel and tells how much of that kernel fell on known pixels.
The pyramid repeats it at halved resolutions, so that a hundred points reach every pixel.
"""

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

# Division guard. 1e-20 rather than 1e-6: the confidence far from any point is 1e-6 and less, and a larger guard
# would pull the depth there towards zero. `clamp_min` instead of "+ eps" survives the ONNX exporter.
DIVISION_GUARD = 1e-20


class NormalizedConv2d(nn.Module):
    """One normalised convolution layer (paper Eqs. 1-3).

    The kernel is stored unconstrained and mapped by Gamma(w) = softplus(w) at each call, so that autograd itself
    supplies the chain rule of Eq. 3. `epsilon` is that of the numerator of Eq. 2: any but zero gives a pixel without
    any known neighbour a positive confidence. `guard` is added to the denominator of Eq. 1 as printed; zero only keeps
    that denominator from being zero. `replaces`: in training the kernel is the weights themselves, after
    `replace_weights`, and Eq. 3 is left out. The release of the paper's [25] replaces them at each call of a layer,
    which for shared layers is several times a step.
    """

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        kernel_size: int,
        beta: float = 10.0,
        epsilon: float = 0.0,
        guard: float = 0.0,
        replaces: bool = False,
    ) -> None:
        super().__init__()
        self.beta = beta
        self.epsilon = epsilon
        self.guard = guard
        self.replaces = replaces
        self.padding = kernel_size // 2
        self.weight = nn.Parameter(_poisson_kernels(in_channels, out_channels, kernel_size, beta))
        self.bias = nn.Parameter(torch.zeros(out_channels))

    def applicability(self) -> Tensor:
        """Gamma(W) of shape (out, in, k, k), strictly positive."""
        return self.weight if self.replaces and self.training else F.softplus(self.weight, beta=self.beta)

    def replace_weights(self) -> None:
        """Put Gamma(W) in the place of W, at the start of a step whose gradient is not to pass through Gamma."""
        with torch.no_grad():
            self.weight.copy_(F.softplus(self.weight, beta=self.beta))

    def unit_kernel(self) -> Tensor:
        """Gamma(W) over its sum for each output channel: the sums of Eqs. 1 and 2, divided beforehand."""
        kernel = self.applicability()
        return kernel / kernel.sum(dim=(1, 2, 3), keepdim=True)

    def forward(self, depth: Tensor, confidence: Tensor) -> tuple[Tensor, Tensor]:
        """(B,in,H,W) depth and confidence -> (B,out,H,W) of each; depth is the bias where nothing is known."""
        kernel = self.unit_kernel()
        known = F.conv2d(confidence, kernel, padding=self.padding)
        weighted = F.conv2d(depth * confidence, kernel, padding=self.padding)
        divisor = known + self._share(self.guard) if self.guard else known
        spread = weighted / divisor.clamp_min(DIVISION_GUARD) + self.bias.view(1, -1, 1, 1)
        return spread, known + self._share(self.epsilon) if self.epsilon else known

    def _share(self, epsilon: float) -> Tensor:
        """A number beside the sums of Eqs. 1 and 2, divided by the kernel's sum as these are: (1,out,1,1)."""
        return epsilon / self.applicability().sum(dim=(1, 2, 3)).view(1, -1, 1, 1)


def _poisson_kernels(in_channels: int, out_channels: int, size: int, beta: float) -> Tensor:
    """Unconstrained weights whose Gamma is a bell (outer product of Poisson pmfs) plus uniform noise."""
    mean = size / 2
    pmf = torch.tensor([math.exp(-mean) * mean**k / math.factorial(k) for k in range(size)])
    bell = torch.outer(pmf, pmf).expand(out_channels, in_channels, size, size)
    applicability = bell + 0.1 * bell.max() * torch.rand(out_channels, in_channels, size, size)
    return torch.log(torch.expm1(beta * applicability)) / beta  # the inverse of softplus


def confidence_pool(depth: Tensor, confidence: Tensor) -> tuple[Tensor, Tensor]:
    """Halve the resolution, keeping in each 2x2 block the depth that is trusted most.

    The confidence is divided by four, the number of pixels that the survivor now stands for.
    (B,C,H,W) -> (B,C,H//2,W//2) of each.
    """
    pooled, index = F.max_pool2d(confidence, 2, return_indices=True)
    chosen = depth.flatten(2).gather(2, index.flatten(2)).view_as(pooled)
    return chosen, pooled / 4


class MultiScaleConfidence(nn.Module):
    """The MSC module: an encoder-decoder of normalised convolutions, two channels wide.

    Layer sharing follows the released unguided network of the paper's [25]: 5x5 `densify` and `refine` serve all
    encoder levels, one 3x3 `merge` per decoder level. With `levels=3` it has the published 481 parameters.
    `replaces`: see `NormalizedConv2d`.
    """

    def __init__(
        self,
        levels: int = 3,
        beta: float = 10.0,
        epsilon: float = 0.0,
        guard: float = 0.0,
        replaces: bool = False,
    ) -> None:
        super().__init__()
        self.levels = levels
        self.replaces = replaces
        self.lift = NormalizedConv2d(1, 2, 5, beta, epsilon, guard, replaces)
        self.densify = NormalizedConv2d(2, 2, 5, beta, epsilon, guard, replaces)
        self.refine = NormalizedConv2d(2, 2, 5, beta, epsilon, guard, replaces)
        self.merge = nn.ModuleList(NormalizedConv2d(4, 2, 3, beta, epsilon, guard, replaces) for _ in range(levels))
        self.project = NormalizedConv2d(2, 1, 1, beta, epsilon, guard, replaces)

    def forward(self, depth: Tensor, confidence: Tensor) -> tuple[Tensor, Tensor]:
        """Sparse depth and its confidence, both (B,1,H,W) with H and W divisible by 2**levels -> dense ones."""
        return self.project(*self.scales(depth, confidence)[-1])

    def scales(self, depth: Tensor, confidence: Tensor) -> list[tuple[Tensor, Tensor]]:
        """Depth and confidence, both (B,2,h,w), at each resolution of the pyramid, the coarsest first, the full one
        last."""
        if self.replaces and self.training:
            for layer in self.modules():
                if isinstance(layer, NormalizedConv2d):
                    layer.replace_weights()
        z, c = self.refine(*self.densify(*self.lift(depth, confidence)))
        pyramid = [(z, c)]
        for level in range(1, self.levels + 1):
            z, c = self.densify(*confidence_pool(z, c))
            if level == 1:
                z, c = self.refine(z, c)
            pyramid.append((z, c))
        scales = [(z, c)]
        for level in range(self.levels - 1, -1, -1):
            fine_z, fine_c = pyramid[level]
            coarse = F.interpolate(torch.cat([z, c], dim=1), scale_factor=2, mode="nearest")  # at once: half the time
            z, c = (torch.cat(both, dim=1) for both in zip((fine_z, fine_c), coarse.chunk(2, dim=1), strict=True))
            z, c = self.merge[level](z, c)
            scales.append((z, c))
        return scales
