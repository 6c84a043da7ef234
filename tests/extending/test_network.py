"""The network of docs/extending.md, saved, loaded and run; tests/completion/networks/test_plug_in.py trains one."""

import numpy as np
import pytest

from completion import DepthCompleter
from completion.networks.checkpoint import load_network, save_network
from completion.networks.protocol import DepthNetwork
from completion.networks.registry import REGISTRY, Entry, build_model
from completion.weights.shipped_weights import validate_weights
from haustra.core.errors import CompletionError
from tests.helpers.recipes import add_row, written


def test_its_weight_file_is_all_that_the_completer_needs(tmp_path, monkeypatch):
    module = written("completion/networks/mean.py", monkeypatch)
    weights = tmp_path / "mean.safetensors"
    network = module.MeanNetwork(module.MeanConfig())
    assert isinstance(network, DepthNetwork)
    save_network(weights, network, network.state_dict(), {})
    with pytest.raises(CompletionError):
        load_network(weights)
    assert add_row(REGISTRY, "completion/networks/registry.py", monkeypatch, {"Entry": Entry}) == "mean"
    assert type(load_network(weights)) is module.MeanNetwork
    assert build_model("mean", start=0.5).offset == 0.5
    validate_weights(weights, 1)
    sparse = np.zeros((40, 50), np.float32)
    sparse[3, 4], sparse[30, 9], sparse[20, 41] = 10, 20, 40
    depth, confidence = DepthCompleter.load(weights)(np.zeros((40, 50, 3), np.uint8), sparse)
    np.testing.assert_allclose(depth, 20, rtol=1e-5)  # the geometric mean
    assert ((confidence > 0) & (confidence < 0.5)).all()
