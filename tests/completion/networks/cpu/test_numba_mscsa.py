"""Compiled loops against the PyTorch functions in whose place they stand."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from completion import DepthCompleter
from completion.data.sampling_training import normalise_log
from completion.inference.completer import load_depth_network
from completion.networks.cpu.numba_mscsa import CompiledAnchor, halved_points, image_planes, recurrent_inputs, unfolded
from completion.networks.mscsa_sfm_kernels import (
    INPUT_RANGES,
    LOG_ERROR_RANGE,
    NCONV_DEPTH_CHANNEL,
    Anchor,
    halve_points,
    image_inputs,
    unfold,
)
from completion.networks.mscsa_sfm_kernels import recurrent_inputs as recurrent_inputs_in_torch
from completion.networks.recurrence import refine_iteratively
from completion.networks.recurrent_norm import fold_batch_norm

SIDES = st.tuples(st.integers(1, 2), st.just(1), *2 * [st.integers(1, 9).map(lambda half: 2 * half)])


def points(shape, share):
    trust = torch.rand(shape) * (torch.rand(shape) < share)
    return torch.randn(shape) * (trust > 0), trust


@settings(max_examples=40, deadline=None)
@given(SIDES, st.sampled_from([0.0, 0.05, 0.6, 1.0]), st.integers(0, 2**32 - 1))
def test_points_are_halved_alike(shape, share, seed):
    torch.manual_seed(seed)
    values, trust = points(shape, share)
    for got, expected in zip(halved_points(values, trust), halve_points(values, trust), strict=True):
        torch.testing.assert_close(got, expected, rtol=1e-5, atol=1e-6)


@settings(max_examples=40, deadline=None)
@given(SIDES, st.integers(0, 2**32 - 1))
def test_what_goes_in_again_and_what_comes_out_is_laid_out_alike(shape, seed):
    torch.manual_seed(seed)
    log_depth, log_error, spread = torch.randn(3, *shape)
    torch.testing.assert_close(
        recurrent_inputs(log_depth, log_error, spread), recurrent_inputs_in_torch(log_depth, log_error, spread)
    )
    out = 3 * torch.randn(shape[0], 9, shape[2] // 2, shape[3] // 2)
    for layout in (out, out.contiguous(memory_format=torch.channels_last)):
        (depth, error), expected = unfolded(layout, spread), unfold(layout, spread)
        torch.testing.assert_close((depth, error), expected)
        assert LOG_ERROR_RANGE[0] <= error.min() <= error.max() <= LOG_ERROR_RANGE[1]
    assert unfolded(out + 100, spread)[1].unique().tolist() == [LOG_ERROR_RANGE[1]]


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 2), st.integers(1, 70), st.integers(1, 70), st.integers(0, 2**32 - 1))
def test_images_of_any_size_are_folded_alike(batch, height, width, seed):
    rgb = np.random.default_rng(seed).integers(0, 256, (batch, height, width, 3), dtype=np.uint8)
    expected = image_inputs(torch.from_numpy(rgb).permute(0, 3, 1, 2).float() / 255)
    torch.testing.assert_close(image_planes(rgb), expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("share", [0.0, 0.02, 0.5])
def test_an_anchor_hears_the_same_points(share):
    torch.manual_seed(5)
    anchor = Anchor(3)
    with torch.no_grad():
        anchor.log_tolerance.fill_(0.4)
        log_sparse, trust = points((2, 1, 64, 96), share)
        log_depth, log_error = log_sparse + 0.3 * torch.randn(trust.shape), torch.randn(trust.shape) - 2
        given = log_depth, log_error, log_sparse, trust, torch.randn(2, 1, 32, 48)
        expected = anchor(*given)
        torch.testing.assert_close(CompiledAnchor(anchor)(*given), expected, rtol=1e-4, atol=1e-5)
    assert (expected != 0).any() == (share > 0)


def test_a_frame_is_completed_as_by_the_network_itself():
    """Both iterations, in single precision, at a size that must be padded."""
    rng = np.random.default_rng(2)
    rgb = rng.integers(20, 236, (1, 90, 120, 3), dtype=np.uint8)
    rgb = (rgb * (130 / rgb.max(axis=3).mean())).clip(0, 255).astype(np.uint8)
    sparse = np.where(rng.random((1, 90, 120)) < 0.01, rng.uniform(5, 40, (1, 90, 120)), 0).astype(np.float32)
    network = load_depth_network("mscsa")
    log_sparse, median = normalise_log(torch.from_numpy(sparse)[:, None])
    trust = (torch.from_numpy(sparse)[:, None] > 0).float()
    completer = DepthCompleter(network, precision="fp32", device="cpu")
    again = fold_batch_norm(network), fold_batch_norm(network, recurrent=True)
    with torch.inference_mode():
        image = completer.network.prepare(torch.from_numpy(rgb).permute(0, 3, 1, 2))
        iterations = (folded.iterate for folded in again)
        expected = refine_iteratively(*iterations, image, log_sparse, trust, completer.iterations)
        compiled = refine_iteratively(
            completer.network.iterate, completer.recurrent.iterate, image, log_sparse, trust, 2
        )
    for got, exact in zip(compiled, expected, strict=True):
        torch.testing.assert_close(got, exact, rtol=1e-4, atol=1e-4)
    depth = (torch.exp(expected.log_depth) * median)[0, 0].numpy()
    np.testing.assert_allclose(
        completer(rgb[0], sparse[0])[0], depth, rtol=0.02
    )  # its brightness is not quite as asked


def test_the_unets_input_is_in_the_order_and_the_range_of_its_quantization(monkeypatch):
    """Channels in the order of `INPUT_RANGES`, MSC depth at `NCONV_DEPTH_CHANNEL`, on an ordinary frame."""
    rng = np.random.default_rng(4)
    y, x = np.mgrid[:96, :128] / 96 - 0.5
    depth = 8 / np.maximum(np.hypot(x, y), 0.08)
    rgb = np.clip(3e4 / depth**2 + rng.normal(0, 4, depth.shape), 0, 255).astype(np.uint8)[..., None].repeat(3, axis=2)
    sparse = np.where(rng.random(depth.shape) < 0.02, depth, 0).astype(np.float32)
    completer = DepthCompleter.load("mscsa", precision="fp32", device="cpu")
    given, spreads = [], []
    for network in (completer.network, completer.recurrent):
        joined, spread = network.unet.joined, network.msc.forward
        monkeypatch.setattr(network.unet, "joined", lambda parts, made=joined: given.append(parts) or made(parts))
        monkeypatch.setattr(
            network.msc, "forward", lambda *points, made=spread: spreads.append(made(*points)) or spreads[-1]
        )
    completer(rgb, sparse)
    ranges = torch.tensor(INPUT_RANGES[0] + INPUT_RANGES[1])
    for parts, (spread, _) in zip(given, spreads, strict=True):
        channels = torch.cat(parts, dim=1)
        assert torch.equal(channels[:, NCONV_DEPTH_CHANNEL : NCONV_DEPTH_CHANNEL + 1], spread)
        largest = channels.abs().amax(dim=(0, 2, 3))
        assert (largest <= ranges * 1.001).all()
    used = largest > 0.1 * ranges  # by the recurrent iteration
    assert used[[0, 4, 8, 12, NCONV_DEPTH_CHANNEL, 17, 18, 19, 24, 25, 26]].all()
    trusts = torch.stack([channels[:, 19], channels[:, 26]])
    assert (trusts.amin(), trusts.amax()) == (0, 1)
    assert not ((channels[:, 25] != 0) & (channels[:, 26] == 0)).any()
