"""The joint form of normalised convolution against the layers that it is made of."""

import pytest
import torch
import torch.nn.functional as F

from completion.infer import load_scale_free
from completion.linear_confidence import LinearConfidence, folded, joint_kernel, of_repeated
from completion.nconv import MultiScaleConfidence, NormalizedConv2d


def layer_with_bias(inputs, outputs, size):
    layer = NormalizedConv2d(inputs, outputs, size)
    with torch.no_grad():
        layer.weight.normal_()
        layer.bias.normal_()
    return layer.double()


@pytest.mark.parametrize("groups", [1, 2])
def test_a_joint_kernel_is_its_layer(groups):
    torch.manual_seed(0)
    layer = layer_with_bias(4, 3, 3)
    depth, confidence = torch.randn(2, 4, 9, 7).double(), torch.rand(2, 4, 9, 7).double()
    confidence[confidence < 0.5] = 0
    parts = zip(confidence.chunk(groups, dim=1), (depth * confidence).chunk(groups, dim=1), strict=True)
    both = torch.cat([x for part in parts for x in part], dim=1)
    known, weighted = torch.nn.functional.conv2d(both, joint_kernel(layer, groups=groups), padding=1).chunk(2, dim=1)
    expected_depth, expected_known = layer(depth, confidence)
    torch.testing.assert_close(known, expected_known)
    torch.testing.assert_close(weighted, expected_depth * expected_known)


@pytest.mark.parametrize("size", [1, 3, 5])
def test_a_folded_kernel_is_its_kernel(size):
    """Up to the picture's edge, where both pad with zeros."""
    torch.manual_seed(size)
    kernel, image = torch.randn(3, 2, size, size).double(), torch.randn(2, 2, 10, 14).double()
    whole = folded(kernel)
    expected = F.conv2d(image, kernel, padding=size // 2)
    got = F.conv2d(F.pixel_unshuffle(image, 2), whole, padding=whole.shape[2] // 2)
    torch.testing.assert_close(F.pixel_shuffle(got, 2), expected)
    doubled = image.repeat_interleave(2, dim=2).repeat_interleave(2, dim=3)
    got = F.conv2d(image, of_repeated(whole), padding=whole.shape[2] // 2)
    torch.testing.assert_close(F.pixel_shuffle(got, 2), F.conv2d(doubled, kernel, padding=size // 2))


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
    with torch.no_grad():
        for got, expected in zip(LinearConfidence(msc)(depth, trust), msc(depth, trust), strict=True):
            torch.testing.assert_close(got, expected, rtol=1e-6, atol=1e-9)
            assert expected[:2].std() > 1e-6
    assert not any(parameter.requires_grad for parameter in LinearConfidence(msc).parameters())


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
