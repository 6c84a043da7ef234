"""The U-Net in 8-bit integers: each piece against integers by hand, the whole against floating point."""

import copy
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import correlate
from torch import nn

from completion import DepthCompleter
from completion.inference.completer import load_depth_network
from completion.networks.cpu.int8_resize import beside_doubled
from completion.networks.cpu.int8_unet import (
    RESIDUAL_STEPS,
    Int8ConvReLU,
    Int8UNet,
    can_use_int8,
    channel_ranges,
)
from completion.networks.mscsa import UNet
from completion.networks.mscsa_sfm_kernels import INPUT_RANGES, NCONV_DEPTH_CHANNEL
from completion.networks.recurrent_norm import fold_batch_norm

needs_vnni = pytest.mark.skipif(not can_use_int8(), reason="this processor or PyTorch has no fast 8-bit integers")
# Of depth in 8 bits against float32, shipped weights: median of a rendered-like frame's relative differences.
TOLERANCE = 0.01
RANGES, FINE = torch.tensor([4.0, 4.0, 4.0, 4.0, 3.0]), (1, 4)  # of the small U-Nets' input


def integers(*shape):
    return torch.randint(0, 256, shape, dtype=torch.uint8).contiguous(memory_format=torch.channels_last)


@needs_vnni
@pytest.mark.parametrize(("size", "zero"), [(3, 0), (1, 0), (3, 128)])
def test_a_convolution_of_integers_is_scipys(size, zero):
    torch.manual_seed(size)
    conv = nn.Conv2d(5, 4, size, padding=size // 2)
    steps, outputs = torch.rand(5) / 50 + 0.01, torch.rand(4) / 20 + 0.01
    made = Int8ConvReLU(conv, steps, outputs, torch.float32, zero)
    weight = made.weight.numpy().astype(np.int64)
    np.testing.assert_array_equal(np.abs(weight).max(axis=(1, 2, 3)), 127)  # of all eight bits
    for shape in ((7, 9), (16, 16), (7, 9), (3, 4), (12, 5), (20, 2)):  # more than are kept
        x = integers(1, 5, *shape)
        padded = np.pad(x[0].numpy().astype(np.int64) - zero, ((0, 0), *2 * [2 * (size // 2,)]))
        sums = np.stack([correlate(padded, kernel, mode="valid")[0] for kernel in weight])
        expected = sums * made.scale.numpy()[:, None, None] + made.bias.numpy()[:, None, None]
        with torch.inference_mode():
            got = made(x)[0].numpy()
        np.testing.assert_allclose(got, np.maximum(expected, 0), rtol=1e-4, atol=1e-3)
        exact = conv((x.float() - zero) * steps.view(1, -1, 1, 1)) / outputs.view(1, -1, 1, 1)
        assert torch.corrcoef(torch.stack([made(x).flatten(), exact.relu().flatten()]))[0, 1] > 0.9999


@needs_vnni
def test_what_comes_out_in_steps_is_rounded_and_ends_at_255():
    torch.manual_seed(0)
    conv, steps = nn.Conv2d(3, 6, 3, padding=1), torch.full((6,), 0.008)
    x = integers(2, 3, 8, 12)
    with torch.inference_mode():
        exact = Int8ConvReLU(conv, torch.full((3,), 0.02), steps, torch.float32)(x)
        whole = Int8ConvReLU(conv, torch.full((3,), 0.02), steps, torch.uint8)(x)
    assert whole.dtype == torch.uint8
    assert exact.max() > 260
    assert ((exact > 0) & (exact < 254)).any()
    assert (whole - exact.clamp(max=255)).abs().max() <= 0.5


@needs_vnni
@pytest.mark.parametrize("fine", [(), (1,), (4, 0)])
def test_the_input_is_held_in_steps_from_the_middle_with_its_residual(fine):
    """Clipped beyond its range; with the residual bits it is `RESIDUAL_STEPS` times as exact."""
    torch.manual_seed(3)
    unet = trained((8, 12))[0]
    made = Int8UNet(fold_batch_norm(unet), channel_ranges(unet), RANGES, fine, torch.float32)
    x = 1.4 * RANGES.view(1, 5, 1, 1) * (2 * torch.rand(2, 5, 6, 8) - 1)
    x[0, :, 0, 0] = 0
    out = made.joined([x[:, :1], x[:, 1:4], x[:, 4:]])
    assert out.is_contiguous(memory_format=torch.channels_last)
    assert out.shape == (2, 8, 6, 8)  # whole words
    assert (out[0, :5, 0, 0] == 128).all()
    steps, held = x * (127 / RANGES).view(1, 5, 1, 1), out.float() - 128
    for channel in range(5):
        residual = held[:, 5 + fine.index(channel)] / RESIDUAL_STEPS if channel in fine else 0
        off = (held[:, channel] + residual - steps[:, channel])[steps[:, channel].abs() <= 127].abs()
        assert off.max() <= (0.5 / RESIDUAL_STEPS if channel in fine else 0.5) + 1e-4
    assert (held[:, :5][steps > 128] == 127).all()
    assert (held[:, :5][steps < -128.5] == -128).all()


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), *2 * [st.integers(1, 9)], *2 * [st.sampled_from([1, 3, 8, 24])], st.integers(1, 3))
def test_doubling_integers_is_bilinear_interpolation_rounded(seed, height, width, channels, beside, batch):
    torch.manual_seed(seed)
    coarse, skip = integers(batch, channels, height, width), integers(batch, beside, 2 * height, 2 * width)
    both = beside_doubled(skip, coarse)
    assert (both[:, :beside] == skip).all()
    exact = F.interpolate(coarse.double(), scale_factor=2, mode="bilinear", align_corners=False)
    assert (both[:, beside:] == (exact + 0.5).floor()).all()


def trained(widths):
    """A U-Net of random weights with the running statistics of noise, and such noise."""
    unet, x = UNet(5, 3, widths, None), torch.randn(2, 5, 48, 64)
    with torch.no_grad():
        for block in (*unet.encoder, *unet.decoder):
            for index in (1, 4):
                block[index].weight.uniform_(0.5, 2)
                block[index].bias.normal_(0, 0.5)
        for _ in range(60):
            unet(torch.randn_like(x))
    return unet.eval(), x


def to_uint8(unet, x, dtype=torch.float32):
    made = Int8UNet(fold_batch_norm(unet), channel_ranges(unet), RANGES, FINE, dtype)
    return made(made.joined([x]))


def by_hand(unet, x):
    """The U-Net with every activation and weight rounded as said, in double precision."""
    folded = fold_batch_norm(unet).double()
    ranges = [tuple(255 / step.double().view(1, -1, 1, 1) for step in pair) for pair in channel_ranges(unet)]
    blocks, levels, x = [*folded.encoder, *folded.decoder], len(folded.encoder), x.double()

    def rounded(x, steps):
        return (x * steps + 0.5 + 1e-6).floor().clamp(max=255) / steps  # halves, which enlarging makes, upwards

    def signed(x, steps):
        return (x * steps + 0.5).floor().clamp(-128, 127) / steps

    def convolved(conv, x, given, made):
        """`given`: steps per unit of what goes in; weights rounded against the largest of each output."""
        weight = conv.weight / given * made.view(-1, 1, 1, 1)
        scale = weight.abs().amax(dim=(1, 2, 3), keepdim=True) / 127
        sums = F.conv2d(x * given, (weight / scale).round() * scale, padding=conv.padding)
        return sums / made + conv.bias.view(1, -1, 1, 1)

    def block(index, x, given):
        first, second = ranges[index]
        x = rounded(convolved(blocks[index][0], x, given, first).relu(), first)
        exact = index in (levels - 1, 2 * levels - 2)
        x = convolved(blocks[index][3], x, first, torch.ones_like(second) if exact else second).relu()
        return x if exact else rounded(x, second)

    def doubled(x):
        return F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)

    of_input = (127 / RANGES).double().view(1, -1, 1, 1)
    rounded_input, fine = signed(x, of_input), list(FINE)
    residual = signed(x[:, fine] - rounded_input[:, fine], RESIDUAL_STEPS * of_input[:, fine])
    conv = blocks[0][0]
    conv.weight = nn.Parameter(torch.cat([conv.weight, conv.weight[:, fine]], dim=1))
    x, given, skips = (
        torch.cat([rounded_input, residual], dim=1),
        torch.cat([of_input, RESIDUAL_STEPS * of_input[:, fine]], dim=1),
        [],
    )
    for level in range(levels):
        x = block(level, F.max_pool2d(x, 2) if level else x, ranges[level - 1][1] if level else given)
        skips.append(x)
    x = skips.pop()
    for index in range(levels, 2 * levels - 1):
        finer = 2 * levels - 2 - index
        if index == levels:
            given = torch.cat([ranges[finer][1], ranges[levels - 1][1]], dim=1) * 127 / 255
            x = signed(torch.cat([skips.pop(), doubled(x)], dim=1), given)
        else:
            before = ranges[index - 1][1]
            x = torch.cat([skips.pop(), rounded(doubled(x), before)], dim=1)
            given = torch.cat([ranges[finer][1], before], dim=1)
        x = block(index, x, given)
    return folded.head(x)


@needs_vnni
@pytest.mark.parametrize(
    "widths",
    [
        pytest.param((8, 12), marks=pytest.mark.slow),
        (8, 12, 16),
        pytest.param((8, 12, 16, 20, 20), marks=pytest.mark.slow),
    ],
)
def test_the_whole_is_the_unet_with_each_value_rounded(widths):
    """As in double precision, but for frames in which a sum lies so near a half that it falls to the other side."""
    torch.manual_seed(len(widths))
    unet, x = trained(widths)[0], torch.randn(8, 5, 32, 48)
    with torch.no_grad():
        got, coarser = to_uint8(unet, x), to_uint8(unet, x, torch.bfloat16)
        expected, exact = by_hand(unet, x), unet(x)
    assert (got.dtype, coarser.dtype) == (torch.float32, torch.bfloat16)
    off = (got - expected).flatten(1).std(dim=1)
    assert (off < 1e-5 * exact.std()).sum() >= 4
    assert off.max() < 0.7 * (got - exact).std()
    assert (got - exact).std() < 0.2 * exact.std()
    assert (coarser - exact).std() < 0.2 * exact.std()


@needs_vnni
def test_every_channel_has_a_step_of_its_own():
    """A channel that is a thousand times as large, and counts for as much less, changes nothing."""
    torch.manual_seed(1)
    unet, x = trained((8, 12, 16))
    with torch.no_grad():
        expected = to_uint8(unet, x)
        unet.encoder[0][4].weight[3] *= 1024
        unet.encoder[0][4].bias[3] *= 1024
        for block in (unet.encoder[1], unet.decoder[-1]):
            block[0].weight[:, 3] /= 1024
        got = to_uint8(unet, x)
    torch.testing.assert_close(got, expected, rtol=1e-4, atol=1e-4 * expected.std().item())


@needs_vnni
def test_the_shipped_model_in_int8_agrees_with_float32():
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:96, :128] / 96 - 0.5
    depth = 8 / np.maximum(np.hypot(x, y), 0.08)
    rgb = np.clip(3e4 / depth**2 + rng.normal(0, 4, depth.shape), 0, 255).astype(np.uint8)[..., None].repeat(3, axis=2)
    sparse = np.zeros(depth.shape, np.float32)
    chosen = rng.choice(depth.size, 100, replace=False)
    sparse.flat[chosen] = depth.flat[chosen]
    network = load_depth_network("mscsa")
    exact, eight = (DepthCompleter(network, precision=precision) for precision in ("fp32", "int8"))
    off = np.abs(eight(rgb, sparse)[0] / exact(rgb, sparse)[0] - 1)
    assert 0 < np.median(off) < TOLERANCE
    errors = [np.abs(np.log(completer(rgb, sparse)[0] / depth)).mean() for completer in (exact, eight)]
    assert errors[1] < 1.1 * errors[0]
    assert np.array_equal(eight(rgb, sparse)[0], eight(rgb, sparse)[0])
    for factor in (0.013, 7, 1000):
        scaled = np.abs(eight(rgb, factor * sparse)[0] / (factor * eight(rgb, sparse)[0]) - 1)
        assert np.median(scaled) < 1e-3
        assert scaled.max() < 0.05
    black = rgb.copy()
    black[:, :64] = 0  # values that no training image had are cut off at 255: worse, and still the same surface
    assert 0 < np.median(np.abs(eight(black, sparse)[0] / exact(black, sparse)[0] - 1)) < 0.05
    both = eight.batch(np.stack([rgb, black]), np.stack([sparse, sparse]))[0]
    np.testing.assert_allclose(both, [eight(rgb, sparse)[0], eight(black, sparse)[0]], rtol=1e-5)
    for again in (copy.deepcopy(eight), pickle.loads(pickle.dumps(eight))):  # noqa: S301 - our own
        np.testing.assert_array_equal(again(rgb, sparse)[0], eight(rgb, sparse)[0])


@needs_vnni
def test_the_shipped_model_is_given_mscs_depth_to_a_part_of_a_step(monkeypatch):
    rng = np.random.default_rng(0)
    rgb = rng.integers(40, 200, (64, 96, 3), dtype=np.uint8)
    sparse = np.where(rng.random((64, 96)) < 0.1, rng.uniform(10, 40, (64, 96)), 0).astype(np.float32)
    completer = DepthCompleter.load("mscsa", precision="int8")
    given = []
    for network in (completer.network, completer.recurrent):
        made = network.unet.joined
        monkeypatch.setattr(
            network.unet, "joined", lambda parts, made=made: given.append((parts, made(parts))) or given[-1][1]
        )
    completer(rgb, sparse)
    assert len(given) == 2
    for parts, out in given:
        steps = torch.cat(parts, dim=1)[:, NCONV_DEPTH_CHANNEL] * 127 / INPUT_RANGES[0][NCONV_DEPTH_CHANNEL]
        held = out.float() - 128
        assert (held[:, NCONV_DEPTH_CHANNEL] - steps).abs().max() > 0.4
        assert (
            held[:, NCONV_DEPTH_CHANNEL] + held[:, 27] / RESIDUAL_STEPS - steps
        ).abs().max() < 0.5 / RESIDUAL_STEPS + 1e-4


@needs_vnni
def test_a_point_beyond_all_numbers_leaves_depth_finite():
    rgb, sparse = np.full((64, 64, 3), 90, np.uint8), np.zeros((64, 64), np.float32)
    sparse[::9, ::7] = 20
    sparse[9, 7], sparse[18, 7] = 1e-45, 3e38
    for precision in ("int8", "bf16", "fp32"):
        depth, confidence = DepthCompleter.load("mscsa", precision=precision)(rgb, sparse)
        assert np.isfinite(depth).all()
        assert np.isfinite(confidence).all()


@needs_vnni
def test_a_onednn_that_is_kept_from_the_instructions_is_not_trusted():
    """Sums of bytes are then cut off at 16 bits, and nobody says so."""
    code = "from completion.networks.cpu.int8_unet import can_use_int8 as can; print(can())"
    for instructions, expected in (("AVX2", "False"), ("ALL", "True")):
        environment = {**os.environ, "ONEDNN_MAX_CPU_ISA": instructions}
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        assert done.stdout.strip() == expected


@needs_vnni
def test_making_it_draws_no_random_number():
    network, before = load_depth_network("mscsa"), torch.get_rng_state()
    DepthCompleter(network, precision="int8")
    assert torch.equal(torch.get_rng_state(), before)
