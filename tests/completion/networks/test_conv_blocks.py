"""Blocks of the U-Net with and without normalisation, against SciPy, literal layers and their own definition."""

import numpy as np
import pytest
import torch
from scipy.signal import correlate
from torch import nn

from completion.networks.checkpoint import load_network, load_tensors
from completion.networks.conv_blocks import FREEZE_AFTER, NORMALISATIONS, FrozenBatchNorm2d, LeakyDoubleConv
from completion.networks.mscsa import MSCSAConfig, MSCSANet
from completion.weights.shipped_weights import resolve_weights
from haustra.core.errors import CompletionError


@pytest.fixture(autouse=True)
def seeded():
    torch.manual_seed(0)


def scipy_conv(x, conv):
    """3x3 convolution of (C,H,W) with zeros around it, one correlation for each pair of channels."""
    weight, bias = conv.weight.detach().numpy(), conv.bias.detach().numpy()
    return np.stack(
        [sum(correlate(x[c], w[c], mode="same") for c in range(len(x))) + b for w, b in zip(weight, bias, strict=True)]
    )


def test_the_plain_block_is_two_convolutions_and_leaky_relus():
    block = LeakyDoubleConv(3, 4, "none").double()
    nn.init.normal_(block[0].bias)
    x = np.random.default_rng(0).standard_normal((3, 9, 8))
    expected = x
    for conv in (block[0], block[3]):
        expected = scipy_conv(expected, conv)
        expected = np.where(expected > 0, expected, 0.1 * expected)
    np.testing.assert_allclose(block(torch.tensor(x)[None])[0].detach().numpy(), expected, atol=1e-12)


def test_features_neither_fade_nor_grow_through_twelve_layers_at_the_start():
    blocks = nn.Sequential(*[LeakyDoubleConv(32, 32, "none") for _ in range(6)])
    x = torch.randn(2, 32, 32, 32)
    with torch.no_grad():
        gain = blocks(x).square().mean() / x.square().mean()
    assert 0.2 < gain < 5
    faded = nn.Sequential(*[m for block in blocks for m in block])
    for conv in faded:
        if isinstance(conv, nn.Conv2d):
            conv.reset_parameters()  # torch's own start
    with torch.no_grad():
        assert faded(x).square().mean() < 0.01 * x.square().mean()


def test_frozen_statistics_make_a_frame_independent_of_its_batch():
    norm, x = FrozenBatchNorm2d(2), torch.randn(5, 2, 4, 4)
    other = torch.cat([x[:1], 3 + 2 * torch.randn(4, 2, 4, 4)])
    assert not torch.equal(norm(x)[0], norm(other)[0])
    for _ in range(FREEZE_AFTER - 2):
        norm(x)
    mean, variance = x.mean((0, 2, 3)), x.var((0, 2, 3))
    before = norm.running_mean.clone()
    assert torch.equal(norm(x)[0], norm(other)[0])
    assert torch.equal(norm.running_mean, before)
    # ten times the average's horizon on the same batch but one: what it learnt is that batch's mean and variance
    torch.testing.assert_close(norm.running_mean, mean, atol=1e-3, rtol=1e-3)
    expected = (x - norm.running_mean.view(1, 2, 1, 1)) / (norm.running_var.view(1, 2, 1, 1) + norm.eps).sqrt()
    torch.testing.assert_close(norm(x), expected)
    torch.testing.assert_close(norm.running_var, variance, atol=0.02, rtol=0.02)


def test_normalising_each_frame_takes_its_scale_away():
    norm, x = NORMALISATIONS["frame"](3), torch.rand(2, 3, 8, 8) + 1
    torch.testing.assert_close(norm(x), norm(5 * x), atol=1e-4, rtol=1e-4)
    flat = x.flatten(1).numpy().astype(float)
    expected = (flat - flat.mean(1, keepdims=True)) / flat.std(1, keepdims=True)
    np.testing.assert_allclose(norm(x).flatten(1).detach().numpy(), expected, atol=1e-3)


@pytest.mark.parametrize("norm", [*NORMALISATIONS, "batch"])
def test_every_normalisation_trains(norm):
    network = MSCSANet(MSCSAConfig(width=4, norm=norm))
    rgb, sparse = torch.rand(2, 3, 64, 64), torch.rand(2, 1, 64, 64) * (torch.rand(2, 1, 64, 64) < 0.05)
    network(rgb, sparse).mean().backward()
    assert all(p.grad is not None and torch.isfinite(p.grad).all() for p in network.parameters())
    with pytest.raises(CompletionError, match="norm is one of"):
        MSCSAConfig(norm="layer")


def literal_block(tensors, prefix):
    """Conv, BatchNorm, ReLU twice, of the tensors of a weight file."""
    layers = []
    for conv, norm in ((0, 1), (3, 4)):
        weight = tensors[f"{prefix}.{conv}.weight"].float()
        layers += [nn.Conv2d(weight.shape[1], weight.shape[0], 3, padding=1, bias=False)]
        layers[-1].weight.data = weight
        layers += [nn.BatchNorm2d(weight.shape[0]), nn.ReLU()]
        names = ("weight", "bias", "running_mean", "running_var")
        layers[-2].load_state_dict({n: tensors[f"{prefix}.{norm}.{n}"].float() for n in names}, strict=False)
    return nn.Sequential(*layers).eval()


def test_the_shipped_network_still_has_its_blocks_bit_for_bit():
    """Its weight file names no `norm`: it must get batch normalisation and ReLU, whatever the paper's networks get."""
    path = resolve_weights("mscsa")
    tensors, network = load_tensors(path)[0], load_network(path)
    blocks = [("encoder", block) for block in network.unet.encoder] + [("decoder", b) for b in network.unet.decoder]
    for index, (part, block) in enumerate(blocks):
        prefix = f"unet.{part}.{index % len(network.unet.encoder)}"
        x = torch.randn(1, tensors[f"{prefix}.0.weight"].shape[1], 16, 16)
        with torch.no_grad():
            assert torch.equal(block(x), literal_block(tensors, prefix)(x))
