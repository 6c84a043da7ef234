"""The linear form of normalised convolution against the layers that it is made of."""

import pytest
import torch

from completion.inference.completer import load_depth_network
from completion.networks.cpu.numba_normalized_conv import LinearConfidence
from completion.networks.normalized_conv import MultiScaleConfidence


@pytest.mark.parametrize("levels", [1, 2, 3, 4])
def test_the_joint_pyramid_is_the_pyramid(levels):
    torch.manual_seed(levels)
    msc = MultiScaleConfidence(levels).double()
    with torch.no_grad():
        for name, parameter in msc.named_parameters():
            if name.endswith("bias"):
                parameter.normal_(0, 0.3)
    shape = (3, 1, 64, 48)
    trust = torch.rand(shape).double() * (torch.rand(shape) < torch.tensor([0.02, 0.2, 0]).view(3, 1, 1, 1))
    depth = torch.randn(shape).double() * (trust > 0)
    depth[0, :, 40:], trust[0, :, 40:] = 0, 0  # a hole that few levels do not reach across
    linear = LinearConfidence(msc)
    with torch.no_grad():
        for got, expected in zip(linear(depth.float(), trust.float()), msc(depth, trust), strict=True):
            assert got.dtype == torch.float32
            torch.testing.assert_close(got.double(), expected, rtol=1e-5, atol=1e-6)
            assert expected[:2].std() > 1e-6


@pytest.mark.parametrize("scale", [1.0, 1e-8, 1e-12])
def test_in_single_precision_the_shipped_pyramids_are_as_exact(scale):
    network = load_depth_network("mscsa")
    torch.manual_seed(3)
    trust = scale * torch.rand(2, 1, 96, 128) * (torch.rand(2, 1, 96, 128) < 0.02)
    depth = 0.4 * torch.randn(trust.shape) * (trust > 0)
    for msc in (network.msc, network.anchor.msc):
        with torch.no_grad():
            (got, known), (expected, expected_known) = LinearConfidence(msc)(depth, trust), msc(depth, trust)
        sure = expected_known > 1e-16  # below that the layers' own divisions are guarded
        assert sure.float().mean() > 0.3
        torch.testing.assert_close(got[sure], expected[sure], rtol=1e-4, atol=1e-5)
        torch.testing.assert_close(known / scale, expected_known / scale, rtol=1e-4, atol=1e-9)


def test_a_confidence_that_is_hardly_there_is_divided_by_all_the_same():
    """One point of trust 1e-15 says as much of the depth as one of trust 1."""
    msc = load_depth_network("mscsa").msc
    depth, trust = torch.zeros(2, 1, 1, 32, 32)
    depth[..., 16, 16], trust[..., 16, 16] = 0.7, 1
    linear = LinearConfidence(msc)
    (expected, known), (got, faint) = linear(depth, trust), linear(depth, 1e-15 * trust)
    near = known > 0.1 * known.max()
    assert near.sum() > 4
    torch.testing.assert_close(got[near], expected[near], rtol=1e-4, atol=1e-5)
    assert (faint[near] < 1e-17).all()  # and the guard is at 1e-20


def test_sides_that_do_not_halve_are_refused():
    with pytest.raises(AssertionError, match="two rows"):
        LinearConfidence(MultiScaleConfidence(2))(torch.zeros(1, 1, 6, 12), torch.zeros(1, 1, 6, 12))
