"""Averages of weight files: the ends are the files themselves, and another network is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from completion.networks.checkpoint import load_network, read_metadata, save_network
from completion.networks.mscsa_sfm import ScaleInvariantConfig, ScaleInvariantMSCSANet
from completion.weights.average import average_weights
from haustra.core.errors import CompletionError


def written(path: Path, seed: int, width: int = 4) -> Path:
    torch.manual_seed(seed)
    network = ScaleInvariantMSCSANet(ScaleInvariantConfig(width=width, iterations=2))
    save_network(path, network, network.state_dict(), {"steps": 10 + seed, "seed": seed})
    return path


def test_an_average_lies_between_its_ends(tmp_path: Path) -> None:
    first, second = written(tmp_path / "a.safetensors", 1), written(tmp_path / "b.safetensors", 2)
    ends = [load_network(path).state_dict() for path in (first, second)]
    for share in (0.0, 0.25, 1.0):
        found = load_network(average_weights(first, second, share, tmp_path / "c.safetensors")).state_dict()
        for name, tensor in found.items():
            if tensor.is_floating_point():
                wanted = (1 - share) * ends[0][name] + share * ends[1][name]
                torch.testing.assert_close(tensor, wanted, rtol=1e-3, atol=1e-5)
    about = read_metadata(tmp_path / "c.safetensors")
    assert (about["steps"], about["averaged"]["share"]) == (12, 1.0)


def test_what_cannot_be_averaged_is_one_sentence(tmp_path: Path) -> None:
    first, other = written(tmp_path / "a.safetensors", 1), written(tmp_path / "b.safetensors", 2, width=8)
    with pytest.raises(CompletionError, match="different networks"):
        average_weights(first, other, 0.5, tmp_path / "c.safetensors")
    with pytest.raises(CompletionError, match="between 0 and 1"):
        average_weights(first, first, 1.5, tmp_path / "c.safetensors")
