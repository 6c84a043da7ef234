"""The early-fusion network: the released layer table counted by hand, and where the sparse depth joins again."""

import pytest
import torch
import torch.nn.functional as F
from torch import nn

from completion.networks.mscsa_early_fusion import EarlyFusionConfig, EarlyFusionMSCSANet
from haustra.core.errors import CompletionError

RELEASED = (
    484_203  # of guided_enc_dec.py of nconv-nyu a708c2d, counted there: five inputs, MSC's depth, RGB, confidence
)
DECODER = ((160, 64), (144, 64), (144, 32), (112, 32), (33, 1))


def count(module: nn.Module) -> int:
    return sum(p.numel() for p in module.parameters())


def test_parameters_are_the_released_ones_and_those_of_one_more_input() -> None:
    assert count(EarlyFusionMSCSANet()) == RELEASED + 9 * 80
    without = count(EarlyFusionMSCSANet(EarlyFusionConfig(use_msc=False)))
    encoder = (9 * 4 * 80 + 80) + 4 * (9 * 80 * 80 + 80)
    assert without == encoder + sum(9 * a * b + b for a, b in DECODER)
    assert count(EarlyFusionMSCSANet(EarlyFusionConfig(use_sa=False))) == RELEASED + 9 * 80


def test_the_raw_sparse_depth_joins_before_the_last_convolution() -> None:
    network = EarlyFusionMSCSANet().eval()
    last = network.decoder[-1]
    nn.init.zeros_(last.weight)
    nn.init.zeros_(last.bias)
    last.weight.data[0, -1, 1, 1] = 1.0
    sparse = torch.rand(2, 1, 50, 70) * (torch.rand(2, 1, 50, 70) < 0.05)
    assert torch.equal(network(torch.rand(2, 3, 50, 70), sparse), sparse)


def test_confidence_joins_before_the_last_convolution_where_it_is_asked_for() -> None:
    network = EarlyFusionMSCSANet(EarlyFusionConfig(confidence_last=True)).eval()
    last = network.decoder[-1]
    nn.init.zeros_(last.weight)
    nn.init.zeros_(last.bias)
    last.weight.data[0, -1, 1, 1] = 1.0
    sparse = torch.rand(1, 1, 64, 64) * (torch.rand(1, 1, 64, 64) < 0.05)
    _, confidence = network.msc(sparse, (sparse > 0).float())
    assert torch.equal(network(torch.rand(1, 3, 64, 64), sparse), confidence)
    with pytest.raises(CompletionError, match="this network has none"):
        EarlyFusionConfig(use_msc=False, all_scales=True)


def test_all_scales_add_three_levels_of_two_depths_and_two_confidences() -> None:
    network = EarlyFusionMSCSANet(EarlyFusionConfig(all_scales=True))
    assert count(network) == RELEASED + 9 * 80 * (1 + 3 * 4)
    sparse = torch.rand(1, 1, 64, 64) * (torch.rand(1, 1, 64, 64) < 0.05)
    levels = network.msc.scales(sparse, (sparse > 0).float())
    assert [tuple(z.shape) for z, _ in levels] == [(1, 2, side, side) for side in (8, 16, 32, 64)]
    for fine, expected in zip(network.msc.project(*levels[-1]), network.msc(sparse, (sparse > 0).float()), strict=True):
        assert torch.equal(fine, expected)


def test_a_level_less_is_the_released_table_without_its_coarsest() -> None:
    network = EarlyFusionMSCSANet(EarlyFusionConfig(levels=4))
    assert count(network) == RELEASED + 9 * 80 - (9 * 80 * 80 + 80) - (9 * 144 * 64 + 64)
    assert network(torch.rand(1, 3, 50, 70), torch.rand(1, 1, 50, 70)).shape == (1, 1, 50, 70)
    with pytest.raises(CompletionError, match="three levels or more, not 2"):
        EarlyFusionConfig(levels=2)


def test_like_channels_weigh_most_where_it_is_asked_for() -> None:
    """A channel orthogonal to the others: by the paper it keeps to itself, by its sources it takes up the others."""
    features = torch.zeros(1, 3, 8, 1)
    features[0, 0, :4] = features[0, 1, :4] = features[0, 2, 4:] = 3.0
    for similar, itself in ((True, 0.999), (False, 0.001)):
        attention = EarlyFusionMSCSANet(EarlyFusionConfig(similar=similar)).attention
        weight = float(attention.attention(features.flatten(2))[0, 2, 2])
        assert weight > itself if similar else weight < itself


def test_a_learnt_weight_of_attention_starts_without_it() -> None:
    torch.manual_seed(0)
    learnt = EarlyFusionMSCSANet(EarlyFusionConfig(learned_gain=True)).eval()
    torch.manual_seed(0)
    without = EarlyFusionMSCSANet(EarlyFusionConfig(use_sa=False)).eval()
    given = torch.rand(1, 3, 64, 64), torch.rand(1, 1, 64, 64)
    assert torch.equal(learnt(*given), without(*given))
    learnt.attention.gain.data.fill_(1.0)
    assert not torch.equal(learnt(*given), without(*given))


@pytest.mark.parametrize("size", [64, 96])
def test_layers_follow_the_released_table(size: int) -> None:
    """Written down again with plain layers, without attention and MSC."""
    torch.manual_seed(0)
    network = EarlyFusionMSCSANet(EarlyFusionConfig(use_msc=False, use_sa=False)).eval()
    rgb, sparse = torch.rand(1, 3, size, size), torch.rand(1, 1, size, size)
    levels = [torch.cat([sparse, rgb], dim=1)]
    for conv in network.encoder:
        assert tuple(conv.weight.shape[2:]) == (3, 3)
        levels.append(F.conv2d(levels[-1], conv.weight, conv.bias, stride=2, padding=1).clamp_min(0))
    x = levels[-1]
    for conv, skip in zip(network.decoder, [*levels[4:0:-1], sparse], strict=True):
        x = torch.cat([x.repeat_interleave(2, 2).repeat_interleave(2, 3), skip], dim=1)
        x = F.conv2d(x, conv.weight, conv.bias, padding=1)
        x = torch.where(x > 0, x, 0.2 * x)
    torch.testing.assert_close(network(rgb, sparse), x, rtol=1e-5, atol=1e-5)
