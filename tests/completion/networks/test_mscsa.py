"""The network's parts against oracles of another kind: literal loops, NumPy, finite differences."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.special import softmax
from torch import nn

from completion.confidence import error_from_confidence
from completion.data.sampling_training import SfmPattern, sample_keypoints, sample_like_sfm, sample_uniform
from completion.inference.completer import DepthCompleter
from completion.networks.channel_attention import StructureAwareness
from completion.networks.mscsa import MSCSAConfig, MSCSANet
from completion.networks.mscsa_sfm import ScaleInvariantMSCSANet
from completion.networks.normalized_conv import MultiScaleConfidence, NormalizedConv2d, confidence_pool
from haustra.core.errors import CompletionError


@pytest.fixture(autouse=True)
def seeded():
    torch.manual_seed(0)


def literal_nconv(z, c, weight, bias, beta, epsilon, guard=0.0):
    """Paper Eqs. 1 and 2 as four nested loops."""
    gamma = np.log1p(np.exp(beta * weight)) / beta
    out_channels, in_channels, k, _ = gamma.shape
    height, width = z.shape[1:]
    z_out, c_out = np.zeros((2, out_channels, height, width))
    for o in range(out_channels):
        for i in range(height):
            for j in range(width):
                numerator = denominator = 0.0
                for ch in range(in_channels):
                    for m in range(k):
                        for n in range(k):
                            y, x = i + m - k // 2, j + n - k // 2
                            if 0 <= y < height and 0 <= x < width:
                                numerator += z[ch, y, x] * c[ch, y, x] * gamma[o, ch, m, n]
                                denominator += c[ch, y, x] * gamma[o, ch, m, n]
                divisor = denominator + guard
                z_out[o, i, j] = (numerator / divisor if divisor > 0 else 0.0) + bias[o]
                c_out[o, i, j] = (denominator + epsilon) / gamma[o].sum()
    return z_out, c_out


@pytest.mark.parametrize(("epsilon", "guard"), [(0.0, 0.0), (0.01, 0.0), (0.0, 0.3)])
def test_normalized_convolution_equals_the_literal_loop(epsilon, guard):
    layer = NormalizedConv2d(2, 3, 3, beta=1.0, epsilon=epsilon, guard=guard).double()
    with torch.no_grad():
        layer.weight.normal_()
        layer.bias.normal_()
    rng = np.random.default_rng(1)
    z, c = rng.uniform(1, 5, (2, 7, 6)), (rng.random((2, 7, 6)) < 0.2).astype(float)
    got = layer(torch.tensor(z)[None], torch.tensor(c)[None])
    expected = literal_nconv(z, c, layer.weight.detach().numpy(), layer.bias.detach().numpy(), 1.0, epsilon, guard)
    for a, b in zip(got, expected, strict=True):
        np.testing.assert_allclose(a[0].detach().numpy(), b, atol=1e-12)


def test_gradient_is_the_chain_rule_of_equation_3():
    layer = NormalizedConv2d(1, 2, 3, beta=1.0).double()
    z, c = torch.rand(1, 1, 5, 5, dtype=torch.double) + 1, torch.rand(1, 1, 5, 5, dtype=torch.double)

    def through(weight):
        return torch.func.functional_call(layer, {"weight": weight}, (z, c))

    assert torch.autograd.gradcheck(through, layer.weight.detach().clone().requires_grad_())


def test_a_step_that_replaces_weights_leaves_the_chain_rule_out():
    """The gradient is that of the kernel itself, and judging applies Gamma to what the step left."""
    torch.manual_seed(0)
    msc = MultiScaleConfidence(replaces=True)
    before = msc.project.weight.detach().clone()
    shared = msc.densify.weight.detach().clone()  # of four levels, and replaced once
    sparse = torch.rand(1, 1, 16, 16)
    msc(sparse, (sparse > 0.7).float())[0].sum().backward()
    torch.testing.assert_close(msc.project.weight.detach(), torch.log1p(torch.exp(10 * before)) / 10)
    after = msc.densify.weight.detach().clone()
    torch.testing.assert_close(after, torch.log1p(torch.exp(10 * shared)) / 10)
    msc.eval()(sparse, (sparse > 0.7).float())
    assert torch.equal(msc.densify.weight, after), "judging leaves weights as they are"
    given = torch.rand(1, 2, 4, 4), torch.rand(1, 2, 4, 4)
    layer, grads = msc.project, []
    for training in (True, False):
        layer.train(training)
        layer.zero_grad()
        layer(*given)[0].sum().backward()
        grads.append(layer.weight.grad.clone())
    plain = NormalizedConv2d(2, 1, 1)
    plain.load_state_dict(layer.state_dict())
    torch.testing.assert_close(layer(*given), plain(*given))
    kernel = layer.weight.detach().clone().requires_grad_()
    share = kernel / kernel.sum()
    depth = (share * (given[0] * given[1])).sum(1) / (share * given[1]).sum(1)
    depth.sum().backward()
    torch.testing.assert_close(grads[0], kernel.grad)
    assert not torch.allclose(grads[0], grads[1])


def test_nothing_known_stays_unknown():
    """An empty pixel keeps confidence zero: Eq. 2's epsilon in the numerator is left out on purpose."""
    layer = NormalizedConv2d(1, 1, 3)
    z, c = torch.zeros(1, 1, 9, 9), torch.zeros(1, 1, 9, 9)
    z[..., 0, 0], c[..., 0, 0] = 3.0, 1.0
    depth, confidence = layer(z, c)
    assert confidence[..., 5, 5] == 0
    assert torch.isfinite(depth).all()
    assert torch.allclose(depth[..., 1, 1], torch.tensor(3.0))


def test_confidence_pool_keeps_the_surest_depth():
    z = torch.arange(16.0).view(1, 1, 4, 4)
    c = torch.zeros(1, 1, 4, 4)
    c[..., 1, 0], c[..., 0, 3], c[..., 3, 3] = 0.9, 0.4, 0.7
    depth, confidence = confidence_pool(z, c)
    assert depth[0, 0].tolist() == [[4.0, 3.0], [8.0, 15.0]]
    assert torch.allclose(confidence[0, 0], torch.tensor([[0.225, 0.1], [0.0, 0.175]]))


def test_pyramid_has_the_published_number_of_parameters():
    assert sum(p.numel() for p in MultiScaleConfidence(levels=3).parameters()) == 481


def test_a_constant_depth_stays_constant():
    msc = MultiScaleConfidence(levels=4)
    with torch.no_grad():
        for name, parameter in msc.named_parameters():
            if name.endswith("bias"):
                parameter.zero_()
    mask = (torch.rand(1, 1, 64, 64) < 0.05).float()
    depth, confidence = msc(7 * mask, mask)
    assert torch.allclose(depth[confidence > 0], torch.tensor(7.0), atol=1e-4)
    assert (confidence > 0).float().mean() > 0.99


@pytest.mark.parametrize("sign", ["distinct", "similar"])
def test_structure_awareness_equals_its_numpy_transcription(sign):
    x = torch.randn(2, 5, 3, 4)
    flat = x.numpy().reshape(2, 5, 12)
    energy = np.einsum("bcn,bdn->bcd", flat, flat)
    if sign == "distinct":
        energy = energy.max(axis=2, keepdims=True) - energy
    expected = np.einsum("bcd,bdn->bcn", softmax(energy, axis=2), flat) + flat
    got = StructureAwareness(sign=sign)(x).numpy().reshape(2, 5, 12)
    np.testing.assert_allclose(got, expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(("msc", "sa"), [(False, False), (True, False), (False, True), (True, True)])
def test_paper_network_keeps_the_image_size(msc, sa):
    network = MSCSANet(MSCSAConfig(width=4, use_msc=msc, use_sa=sa)).eval()
    rgb, sparse = torch.rand(2, 3, 50, 70), torch.rand(2, 1, 50, 70) * (torch.rand(2, 1, 50, 70) < 0.05)
    assert network(rgb, sparse).shape == (2, 1, 50, 70)


def test_residual_network_corrects_the_depth_of_msc():
    network = MSCSANet(MSCSAConfig(width=4, residual=True)).eval()
    nn.init.zeros_(network.unet.head.weight)
    nn.init.constant_(network.unet.head.bias, 0.25)
    rgb, sparse = torch.rand(1, 3, 64, 64), torch.rand(1, 1, 64, 64) * (torch.rand(1, 1, 64, 64) < 0.1)
    depth, _ = network.msc(sparse, (sparse > 0).float())
    torch.testing.assert_close(network(rgb, sparse), depth + 0.25)
    with pytest.raises(CompletionError, match="no MSC"):
        MSCSANet(MSCSAConfig(use_msc=False, residual=True))


def sparse_frame(height=96, width=112, points=60, seed=0):
    rng = np.random.default_rng(seed)
    rgb = rng.integers(0, 255, (height, width, 3), dtype=np.uint8)
    sparse = np.zeros((height, width), np.float32)
    sparse.flat[rng.choice(height * width, points, replace=False)] = rng.uniform(10, 60, points)
    return rgb, sparse


@pytest.fixture(scope="module")
def completer():
    torch.manual_seed(3)
    return DepthCompleter(ScaleInvariantMSCSANet(), precision="fp32")


@pytest.mark.parametrize("factor", [0.01, 3.7, 1000.0])
def test_completion_is_scale_equivariant(completer, factor):
    rgb, sparse = sparse_frame()
    depth, confidence = completer(rgb, sparse)
    scaled, same_confidence = completer(rgb, (factor * sparse).astype(np.float32))
    np.testing.assert_allclose(scaled, factor * depth, rtol=2e-5)
    np.testing.assert_allclose(same_confidence, confidence, rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("points", [0, 1, 5])
def test_few_points_are_defined(completer, points):
    depth, confidence = completer(*sparse_frame(points=points))
    assert np.isfinite(depth).all()
    assert np.isfinite(confidence).all()
    assert bool((depth > 0).all()) == (points > 0)


def test_invalid_sparse_depth_counts_as_none(completer):
    rgb, sparse = sparse_frame()
    spoilt = sparse.copy()
    empty = np.flatnonzero(sparse == 0)
    spoilt.flat[empty[0]], spoilt.flat[empty[1]], spoilt.flat[empty[2]] = np.nan, -5, np.inf
    np.testing.assert_array_equal(completer(rgb, spoilt)[0], completer(rgb, sparse)[0])


def test_folding_batch_normalisation_changes_nothing():
    rgb, sparse = torch.rand(1, 3, 64, 64), (torch.rand(1, 1, 64, 64) < 0.05).float()
    network = ScaleInvariantMSCSANet().eval()
    for module in network.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            module.running_mean.normal_()
            module.running_var.uniform_(0.5, 2)
    with torch.no_grad():
        before = network(rgb, 0.1 * sparse, sparse)
        after = DepthCompleter(network, precision="fp32").network(rgb, 0.1 * sparse, sparse)
    for a, b in zip(before, after, strict=True):
        assert torch.allclose(a, b, atol=1e-4)


@pytest.mark.parametrize("points", [1, 100, 5000])
def test_samplers_take_exact_counts_of_true_depths_by_seed(points):
    rgb, depth = torch.rand(3, 3, 80, 90), 5 + 50 * torch.rand(3, 1, 80, 90)
    depth[:, :, :10] = 0

    def both(seed):
        generator = torch.Generator().manual_seed(seed)
        return sample_uniform(depth, points, generator), sample_keypoints(rgb, depth, points, generator)

    for sparse, again in zip(both(1), both(1), strict=True):
        assert (sparse > 0).flatten(1).sum(1).tolist() == [points] * 3
        assert torch.equal(sparse[sparse > 0], depth[sparse > 0])
        assert torch.equal(sparse, again)
    assert not torch.equal(both(1)[0], both(2)[0])


def test_known_errors_are_those_of_the_points_and_doubt_and_outliers_give_them_tails():
    """A tenth of the points of real runs err by over 2.2 to 3.0 of their errors, half by over 0.5 to 0.7; training has
    a few more outliers than they."""
    rgb, depth = torch.rand(32, 3, 96, 96), torch.full((32, 1, 96, 96), 20.0)
    known = SfmPattern(min_points=1000, corner_share=0, known_error_share=1)
    tails = []
    for pattern in (replace(known, max_doubt=0, max_outliers=0), known):
        sparse, trust = sample_like_sfm(rgb, depth, pattern, torch.Generator().manual_seed(0))
        told = error_from_confidence(trust[sparse > 0].numpy().astype(np.float64))
        off = np.abs(np.log(sparse[sparse > 0].numpy() / 20)) / told
        assert 0.6 < np.median(off) < 0.74  # of a normal distribution: 0.674
        tails.append(np.quantile(off, 0.9))
    assert tails[0] == pytest.approx(1.645, abs=0.08)
    assert 2.2 < tails[1] < 3.3


def test_sfm_like_points_have_noise_outliers_and_no_points_without_truth():
    generator = torch.Generator().manual_seed(0)
    rgb, depth = torch.rand(96, 3, 96, 96, generator=generator), torch.full((96, 1, 96, 96), 20.0)
    depth[:, :, :, :20] = 0
    sparse, trust = sample_like_sfm(rgb, depth, SfmPattern(), generator)
    assert torch.equal(sparse > 0, trust > 0)
    assert (sparse[..., :20] == 0).all()
    ratio = sparse[sparse > 0] / 20
    assert 0.005 < (ratio.log().abs() > 0.3).float().mean() < 0.12
    assert 0.005 < ratio.log().abs().median() < 0.06
