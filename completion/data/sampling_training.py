"""Sparse depth out of dense depth: the paper's two samplers and one that behaves like structure from motion.

All work on a batch on any device, draw from a given `torch.Generator` and give exact counts:
(B,1,H,W) sparse depth, 0 = none.
"""

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from completion.confidence import confidence_from_error
from completion.data.draws import moved, normal_draws, on_host, uniform_draws
from completion.data.sampling_benchmark import features
from haustra.core.errors import CompletionError

FARTHEST = 20.0  # |log(depth / median)| of a point: far beyond any outlier, and what follows from it stays finite


def _pick(score: Tensor, counts: Tensor) -> Tensor:
    """Boolean (B,1,H,W): the counts[b] pixels of highest score; never one whose score is -inf."""
    batch, _, height, width = score.shape
    flat = score.flatten(1)
    most = int(counts.max()) if batch else 0
    values, index = flat.topk(min(most, flat.shape[1]), dim=1)
    counts = moved(counts, score.device)
    keep = (torch.arange(index.shape[1], device=score.device) < counts[:, None]) & torch.isfinite(values)
    picked = torch.zeros_like(flat, dtype=torch.bool).scatter_(1, index, keep)
    return picked.view(batch, 1, height, width)


def _uniform_score(like: Tensor, generator: torch.Generator) -> Tensor:
    return uniform_draws(like.shape, generator).to(like.device)


def sample_uniform(depth: Tensor, points: int, generator: torch.Generator) -> Tensor:
    """US-SD: `points` valid pixels at random, without replacement (fewer where there are fewer)."""
    score = _uniform_score(depth, generator).masked_fill(depth <= 0, float("-inf"))
    picked = _pick(score, torch.full((len(depth),), points))
    return torch.where(picked, depth, torch.zeros_like(depth))


def sample_by_chance(depth: Tensor, points: int, generator: torch.Generator) -> Tensor:
    """Each valid pixel by itself, `points` of a frame in the mean, as in evaluation."""
    candidates = (depth > 0).flatten(1).sum(dim=1).view(-1, 1, 1, 1).clamp_min(1)
    picked = (_uniform_score(depth, generator) < points / candidates) & (depth > 0)
    return torch.where(picked, depth, torch.zeros_like(depth))


def corner_response(rgb: Tensor) -> Tensor:
    """Shi-Tomasi's smaller eigenvalue of the structure tensor, (B,3,H,W) in [0,1] -> (B,1,H,W)."""
    grey = rgb.mean(dim=1, keepdim=True)
    dx = F.pad(grey[..., 2:] - grey[..., :-2], (1, 1, 0, 0))
    dy = F.pad(grey[..., 2:, :] - grey[..., :-2, :], (0, 0, 1, 1))
    xx, yy, xy = (F.avg_pool2d(p, 5, 1, 2) for p in (dx * dx, dy * dy, dx * dy))
    return (xx + yy) / 2 - torch.sqrt((xx - yy) ** 2 / 4 + xy * xy + 1e-12)


def corner_peaks(rgb: Tensor) -> Tensor:
    """Local maxima of the corner response in 5x5 windows; boolean (B,1,H,W)."""
    response = corner_response(rgb)
    return (response == F.max_pool2d(response, 5, 1, 2)) & (response > 1e-7)


def sample_keypoints(rgb: Tensor, depth: Tensor, points: int, generator: torch.Generator) -> Tensor:
    """FS-SD as in evaluation (`sampling_benchmark.features`): SIFT keypoints, strongest first; then uniform pixels."""
    seeds = torch.randint(2**31, (len(rgb),), generator=generator, device=generator.device).tolist()
    images = (255 * rgb).round().to(torch.uint8).permute(0, 2, 3, 1).cpu().numpy()
    sparse = [
        features(np.ascontiguousarray(image), truth, points, np.random.default_rng(seed)).depth
        for image, truth, seed in zip(images, depth[:, 0].float().cpu().numpy(), seeds, strict=True)
    ]
    return torch.from_numpy(np.stack(sparse))[:, None].to(depth.device)


@dataclass(frozen=True)
class SfmPattern:
    """Ranges of the structure-from-motion-like sampler; each frame draws its own values."""

    min_points: int = 15
    max_points: int = 2000  # log-uniform between the two
    corner_share: float = 0.75  # frames whose points sit on corners; the rest are uniform
    hole_share: float = 0.5  # frames in which a disc without points is cut out
    near_bare_share: float = 0.25  # frames whose nearest wall, up to `max_near_bare` of the pixels, has no point
    max_near_bare: float = 0.35
    border_bare_share: float = 0.4  # frames with a margin without points, up to `max_border_bare` of the width
    max_border_bare: float = 0.08
    max_noise: float = 0.06  # relative depth noise, uniform from 0 where it is not known
    min_known_noise: float = 0.003  # log-uniform from here where it is: an adjusted map knows its points to 1 %
    max_outliers: float = 0.12  # share of points with a wrong depth, uniform from 0; 7 % of real ones err by over 10 %
    known_error_share: float = 0.6  # frames whose points differ in noise and are trusted accordingly
    max_doubt: float = (
        1.2  # of a known error, log-normal about it: a tenth of real points err by over 2.2 to 3 of theirs
    )

    def __post_init__(self) -> None:
        if not 0 < self.min_points <= self.max_points:
            raise CompletionError(f"points must be 0 < min <= max, got {self.min_points} and {self.max_points}")


def sample_like_sfm(
    rgb: Tensor, depth: Tensor, pattern: SfmPattern, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Corners with holes, noise and outliers -> sparse depth and trust, both (B,1,H,W).

    Trust is 1 at points, or where their errors are known what `confidence_from_error` makes of them.
    """
    batch = len(depth)

    def draw(low: float, high: float) -> Tensor:
        return low + (high - low) * uniform_draws((batch, 1, 1, 1), generator).to(depth.device)

    def normal() -> Tensor:
        return normal_draws(depth.shape, generator).to(depth.device)

    ratio = pattern.max_points / pattern.min_points
    counts = (pattern.min_points * ratio ** uniform_draws((batch,), on_host(generator))).long()
    on_corners = draw(0, 1) < pattern.corner_share
    # SIFT finds nothing in burnt-out and in black areas, however many corners noise makes there. Two channels that
    # clip leave no texture, whatever the third does.
    lit = (rgb.amax(1, keepdim=True) > 0.04) & (rgb.median(1, keepdim=True).values < 0.96)
    score = _uniform_score(depth, generator)
    score = torch.where(on_corners & corner_peaks(rgb) & lit, score + 1, score)
    # A pattern that ran out of corners would fill up with uniform points; SfM just has fewer.
    score = score.masked_fill(on_corners & (score < 1) & (score > 0.002), float("-inf"))
    bare = _holes(depth, pattern, generator) | _bare_near(depth, pattern, generator)
    score = score.masked_fill((depth <= 0) | bare | _bare_border(depth, pattern, generator), float("-inf"))
    picked = _pick(score, counts)
    known = draw(0, 1) < pattern.known_error_share
    of_known = pattern.min_known_noise * (pattern.max_noise / pattern.min_known_noise) ** draw(0, 1)
    error = torch.where(known, of_known * torch.exp(normal()), draw(0, pattern.max_noise))
    doubt = torch.where(known, draw(0, pattern.max_doubt), 0) * normal()
    noisy = depth * torch.exp((error * torch.exp(doubt)).clamp_max(1) * normal())
    wrong = _uniform_score(depth, generator) < draw(0, pattern.max_outliers)
    factor = torch.exp(0.7 * normal())
    sparse = torch.where(wrong, noisy * factor, noisy) * picked
    return sparse, picked * torch.where(known, confidence_from_error(error), 1)


def _holes(depth: Tensor, pattern: SfmPattern, generator: torch.Generator) -> Tensor:
    """A disc of random place and size in some frames; boolean (B,1,H,W)."""
    batch, _, height, width = depth.shape
    down, right, size, chance = uniform_draws((4, batch, 1, 1, 1), generator).to(depth.device)
    rows = torch.arange(height, device=depth.device).view(1, 1, height, 1) - down * height
    columns = torch.arange(width, device=depth.device).view(1, 1, 1, width) - right * width
    radius = (0.1 + 0.4 * size) * max(height, width)
    return (rows * rows + columns * columns < radius * radius) & (chance < pattern.hole_share)


def _bare_near(depth: Tensor, pattern: SfmPattern, generator: torch.Generator) -> Tensor:
    """The nearest wall of some frames, as a fold that burns and has no corner; boolean (B,1,H,W)."""
    share, chance = uniform_draws((2, len(depth)), generator).to(depth.device)
    ordered = torch.where(depth > 0, depth, torch.inf).flatten(1).sort(dim=1).values
    known = torch.isfinite(ordered).sum(dim=1)
    rank = (share.double() * pattern.max_near_bare * known).long().clamp_min(1)
    farthest = ordered.gather(1, rank[:, None] - 1)[:, 0].where(chance < pattern.near_bare_share, 0)
    return depth <= farthest.view(-1, 1, 1, 1)


def _bare_border(depth: Tensor, pattern: SfmPattern, generator: torch.Generator) -> Tensor:
    """A margin of some frames; boolean (B,1,H,W)."""
    height, width = depth.shape[2:]
    share, chance = uniform_draws((2, len(depth), 1, 1, 1), generator).to(depth.device)
    margin = (share.double() * (pattern.max_border_bare * width)).long().where(chance < pattern.border_bare_share, 0)
    rows, columns = (torch.arange(side, device=depth.device) for side in (height, width))
    inside_rows = (rows >= margin) & (rows < height - margin)
    inside_columns = (columns >= margin) & (columns < width - margin)
    return ~(inside_rows.transpose(2, 3) & inside_columns)


def median_of_points(sparse: Tensor) -> Tensor:
    """Median of each frame's positive values, (B,1,H,W) -> (B,1,1,1): the lower of the middle two; 1 where a frame has
    none."""
    if sparse.is_cuda:  # the loop would wait for the GPU at each frame; on a CPU it takes half as long
        values = torch.where(sparse > 0, sparse, torch.nan).flatten(1).nanmedian(dim=1).values
        return torch.where(values.isnan(), 1.0, values).view(-1, 1, 1, 1)
    known = [frame[frame > 0] for frame in sparse]
    medians = [values.median() if len(values) else values.new_ones(()) for values in known]
    return torch.stack(medians).view(-1, 1, 1, 1)


def normalise_log(sparse: Tensor) -> tuple[Tensor, Tensor]:
    """Sparse depth -> (log(depth / median) with 0 where there is none, median (B,1,1,1)); finite for any point."""
    median = median_of_points(sparse)
    return torch.where(sparse > 0, sparse / median, 1.0).log_().clamp_(-FARTHEST, FARTHEST), median
