"""Points that training draws: where none may lie, and how far those of other frames' depths are off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.stats import binom

from completion.confidence import error_from_confidence
from completion.data.sampling_benchmark import get_sampler
from completion.data.sampling_neighbours import merged, sample_like_neighbours
from completion.data.sampling_training import SfmPattern, median_of_points, sample_by_chance, sample_like_sfm

EVERYWHERE = SfmPattern(
    min_points=1500, max_points=1500, corner_share=0.0, hole_share=0.0, near_bare_share=0.0, border_bare_share=0.0
)
SIZE = 96


def frames(count: int = 8) -> tuple[torch.Tensor, torch.Tensor]:
    """Grey images and a ramp of depth from 10 to 50."""
    ramp = torch.linspace(10, 50, SIZE).expand(count, 1, SIZE, SIZE).contiguous()
    return torch.full((count, 3, SIZE, SIZE), 0.5), ramp


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_a_bare_near_wall_has_no_point_and_all_else_has() -> None:
    rgb, depth = frames()
    sparse, _ = sample_like_sfm(rgb, depth, replace(EVERYWHERE, near_bare_share=1.0), generator())
    for frame in (sparse > 0)[:, 0]:
        columns = np.flatnonzero(frame.any(dim=0).numpy())
        assert 1 <= columns.min() <= 0.36 * SIZE  # a ramp: the nearest wall is on the left
        assert columns.max() == SIZE - 1
        assert np.diff(columns).max() <= 2


def test_a_bare_near_wall_is_at_most_a_third_of_what_has_depth() -> None:
    rgb, depth = frames()
    depth[:, :, : SIZE // 2] = 0
    sparse, _ = sample_like_sfm(rgb, depth, replace(EVERYWHERE, near_bare_share=1.0), generator())
    for frame, truth in zip((sparse > 0)[:, 0], depth[:, 0], strict=True):
        nearest = truth[frame].min()
        assert ((truth > 0) & (truth < nearest)).sum() <= EVERYWHERE.max_near_bare * (truth > 0).sum() + SIZE


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
def test_a_gpu_finds_the_median_that_a_cpu_finds() -> None:
    sparse = torch.rand(5, 1, SIZE, SIZE, generator=generator()) * (torch.rand(5, 1, SIZE, SIZE) < 0.1)
    sparse[2] = 0
    assert torch.equal(median_of_points(sparse.cuda()).cpu(), median_of_points(sparse))


def test_a_bare_border_has_no_point() -> None:
    rgb, depth = frames()
    sparse, _ = sample_like_sfm(
        rgb, depth, replace(EVERYWHERE, border_bare_share=1.0, max_border_bare=0.2), generator()
    )
    margins = [np.flatnonzero(f.any(dim=0).numpy()).min() for f in (sparse > 0)[:, 0]]
    for frame, margin in zip((sparse > 0)[:, 0], margins, strict=True):
        assert not frame[:margin].any()
        assert not frame[SIZE - margin :].any()
    assert len(set(margins)) > 3
    assert max(margins) <= 0.2 * SIZE + 1


def test_corners_are_not_found_where_two_channels_clip() -> None:
    noise = torch.rand(4, 3, SIZE, SIZE, generator=generator(1))
    burnt = noise.clone()
    burnt[:, :2, :, : SIZE // 2] = 1.0
    pattern = replace(EVERYWHERE, corner_share=1.0, max_points=400, min_points=400)
    sparse, _ = sample_like_sfm(burnt, frames(4)[1], pattern, generator())
    left, right = (sparse[..., : SIZE // 2] > 0).sum(), (sparse[..., SIZE // 2 :] > 0).sum()
    assert left < 0.15 * right  # what lies along the border between the halves, and one pixel in 500 anywhere


def test_depths_of_other_frames_err_smoothly_and_about_as_much_as_they_say() -> None:
    depth = torch.full((64, 1, SIZE, SIZE), 20.0)
    sparse, trust = sample_like_neighbours(depth, generator())
    found = sparse > 0
    stated = error_from_confidence(trust[found].numpy())
    actual = (sparse / depth).log().abs()[found].numpy()
    assert np.median(actual / stated) == pytest.approx(0.67, abs=0.15)  # of a normal distribution of that sigma
    # Neighbouring points of a patch err alike, where features would not.
    off = torch.where(found, (sparse / depth).log(), torch.nan)[:, 0]
    rows, columns = (np.flatnonzero(found.any(dim=d).any(dim=0)[0].numpy()) for d in (3, 2))
    grid = off[:, rows][:, :, columns].numpy()
    pairs = np.stack([grid[:, :, 1:].ravel(), grid[:, :, :-1].ravel()])
    pairs = pairs[:, np.isfinite(pairs).all(axis=0)]
    assert np.corrcoef(pairs)[0, 1] > 0.4


def test_a_part_of_the_picture_that_no_other_frame_saw_has_no_point() -> None:
    depth = torch.full((64, 1, SIZE, SIZE), 20.0)
    sparse, _ = sample_like_neighbours(depth, generator())
    full = (SIZE / 10) ** 2  # at the widest spacing
    counts = (sparse > 0).sum(dim=(1, 2, 3)).numpy()
    assert counts.min() > 0.2 * full
    assert counts.std() > 0.1 * counts.mean()


def test_measured_points_stay_when_others_join() -> None:
    rgb, depth = frames()
    sparse, trust = sample_like_sfm(rgb, depth, EVERYWHERE, generator())
    others = sample_like_neighbours(depth, generator(2))
    both, both_trust = merged(sparse, trust, *others)
    measured = trust > 0
    assert torch.equal(both[measured], sparse[measured])
    assert torch.equal(both_trust[~measured], others[1][~measured])


def test_the_same_seed_draws_the_same_points() -> None:
    rgb, depth = frames()
    pattern = SfmPattern(min_points=100, max_points=300)
    for draw in (lambda g: sample_like_sfm(rgb, depth, pattern, g), lambda g: sample_like_neighbours(depth, g)):
        assert all(torch.equal(a, b) for a, b in zip(draw(generator(5)), draw(generator(5)), strict=True))
        assert not torch.equal(draw(generator(5))[0], draw(generator(6))[0])


def test_points_by_chance_have_the_counts_of_a_binomial_law_in_training_and_judging() -> None:
    _, depth = frames(400)
    depth[:, :, :, ::2] = 0  # half of the pixels have no truth
    trained = sample_by_chance(depth, 100, generator())
    image, rng = np.zeros((SIZE, SIZE, 3), np.uint8), np.random.default_rng(0)
    judge = get_sampler("by_chance")
    judged = np.stack([judge(image, truth, 100, rng).depth for truth in depth[:, 0].numpy()])
    candidates = SIZE * SIZE // 2
    law = binom(candidates, 100 / candidates)
    for sparse in (trained[:, 0].numpy(), judged):
        assert np.all((sparse == 0) | (sparse == depth[:, 0].numpy()))
        counts = (sparse > 0).sum(axis=(1, 2))
        assert abs(counts.mean() - law.mean()) < 4 * law.std() / np.sqrt(len(counts))
        assert counts.var(ddof=1) == pytest.approx(law.var(), rel=0.3)
    assert torch.equal(trained, sample_by_chance(depth, 100, generator()))
