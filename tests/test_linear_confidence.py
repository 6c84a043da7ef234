"""The linear form of normalised convolution against the layers that it is made of."""

import pytest
import torch

from completion.infer import load_scale_free
from completion.linear_confidence import LinearConfidence
from completion.nconv import MultiScaleConfidence


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


@pytest.mark.parametrize("scale", [1.0, 1e-8])
def test_in_single_precision_the_shipped_pyramids_are_as_exact(scale):
    network = load_scale_free("mscsa")
    torch.manual_seed(3)
    trust = scale * torch.rand(2, 1, 96, 128) * (torch.rand(2, 1, 96, 128) < 0.02)
    depth = 0.4 * torch.randn(trust.shape) * (trust > 0)
    for msc in (network.msc, network.anchor.msc):
        with torch.no_grad():
            (got, known), (expected, expected_known) = LinearConfidence(msc)(depth, trust), msc(depth, trust)
        torch.testing.assert_close(got, expected, rtol=1e-4, atol=1e-5)
        torch.testing.assert_close(known / scale, expected_known / scale, rtol=1e-4, atol=1e-9)
