"""Points as other frames' completed depths give them, simulated from one frame's truth for training.

A depth that was completed in another view and carried over errs smoothly, unlike a feature: a whole patch of wall is a
little too far. At a fold's edge it may be that of the wall behind, some patches no other frame saw, and the error that
comes with it is an estimate. `pipeline.depth.multiview_stage` makes the real ones.
"""

import torch
import torch.nn.functional as F
from torch import Tensor

from completion.confidence import confidence_from_error
from completion.data.draws import integer_draw, normal_draws, uniform_draws

GRID_STEPS = (5, 11)  # px: lower and (excluded) upper bound of the points' spacing
ERRORS = (0.004, 0.08)  # relative, log-uniform: a frame's typical one
SPREAD = 0.7  # log: how a frame's patches differ from its typical error
DOUBT = 0.4  # log: how the error that is stated differs from the one that is drawn
MISPLACED_PX = 1.5  # standard deviation of where a depth lands beside its place
LEAST_SEEN = 0.3  # share of the picture that other frames saw, at least
COARSEST, FINEST = 48, 12  # px, wavelengths of the errors


def sample_like_neighbours(depth: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """True depth (B,1,H,W), 0 = none -> depth at some pixels and its trust, both (B,1,H,W), 0 = none."""
    batch = len(depth)

    def uniform(low: float, high: float) -> Tensor:
        return low + (high - low) * uniform_draws((batch, 1, 1, 1), generator).to(depth.device)

    typical = ERRORS[0] * (ERRORS[1] / ERRORS[0]) ** uniform(0, 1)
    error = typical * torch.exp(SPREAD * smooth_noise(depth, COARSEST, generator))
    off = error * (0.7 * smooth_noise(depth, COARSEST, generator) + 0.7 * smooth_noise(depth, FINEST, generator))
    seen = smooth_noise(depth, COARSEST, generator).flatten(1)
    share = uniform(0, 1 - LEAST_SEEN).view(batch, 1)
    hidden = seen < torch.quantile(seen[:, ::7], share.view(-1), dim=1).diagonal()[:, None]
    stated = error * torch.exp(DOUBT * normal_draws((batch, 1, 1, 1), generator).to(depth.device))
    points = _beside(depth, generator) * torch.exp(off.clamp(-1, 1))
    step = integer_draw(*GRID_STEPS, generator)
    first = integer_draw(0, step, generator)
    kept = torch.zeros_like(depth, dtype=torch.bool)
    kept[..., first::step, first::step] = True
    kept &= (points > 0) & ~hidden.view(depth.shape)
    return points * kept, confidence_from_error(stated) * kept


def smooth_noise(like: Tensor, wavelength_px: int, generator: torch.Generator) -> Tensor:
    """Noise (B,1,H,W) of mean 0 and standard deviation about 1, smooth over `wavelength_px`."""
    height, width = like.shape[2:]
    size = max(2, height // wavelength_px), max(2, width // wavelength_px)
    coarse = normal_draws((len(like), 1, *size), generator).to(like.device)
    return 1.3 * F.interpolate(coarse, size=(height, width), mode="bicubic", align_corners=False)


def _beside(depth: Tensor, generator: torch.Generator) -> Tensor:
    """Depth at each pixel of a place some pixels beside it."""
    batch, _, height, width = depth.shape
    moved = (MISPLACED_PX * normal_draws((batch, 2, height, width), generator)).round().long().to(depth.device)
    rows = (torch.arange(height, device=depth.device)[None, :, None] + moved[:, 0]).clamp(0, height - 1)
    columns = (torch.arange(width, device=depth.device)[None, None, :] + moved[:, 1]).clamp(0, width - 1)
    return depth.flatten(1).gather(1, (rows * width + columns).flatten(1)).view(depth.shape)


def merged(sparse: Tensor, trust: Tensor, others: Tensor, others_trust: Tensor) -> tuple[Tensor, Tensor]:
    """Measured points and those of other frames, each depth and trust (B,1,H,W): measured ones stay."""
    measured = trust > 0
    return torch.where(measured, sparse, others), torch.where(measured, trust, others_trust)
