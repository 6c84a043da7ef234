"""A network of one's own: a class and one row of the registry make it trainable, loadable, usable and judgeable."""

import copy
import json
from dataclasses import dataclass

import numpy as np
import onnxruntime
import pytest
import torch
from torch import nn

from completion import DepthCompleter
from completion.evaluation.outputs import Outputs
from completion.evaluation.run import evaluate, protocol_of
from completion.inference.onnx_export import export_onnx
from completion.networks.checkpoint import load_network, save_network
from completion.networks.protocol import GRID, DepthNetwork, Estimate
from completion.networks.registry import REGISTRY, Entry, described_network, find_entry
from completion.training.config import make_config, with_new_names
from completion.training.train import train
from completion.weights.shipped_weights import validate_weights
from haustra.core.errors import CompletionError
from haustra.core.progress import SilentProgress
from haustra.phantom.dataset.generate import generate
from tests.helpers.tiny_phantom import TINY


@dataclass(frozen=True)
class MeanConfig:
    start: float = 0.0


class MeanNetwork(nn.Module):
    """The trusted mean of the points' log depth, plus a constant that is learnt, everywhere."""

    precisions = ("fp32",)
    stride = 1

    def __init__(self, config):
        super().__init__()
        self.config = config
        self.offset = nn.Parameter(torch.tensor(config.start))

    def prepare(self, rgb):
        return rgb

    def iterate(self, image, log_sparse, trust, last=None, grid=GRID):
        mean = (log_sparse * trust).sum((2, 3), keepdim=True) / trust.sum((2, 3), keepdim=True).clamp_min(1e-6)
        everywhere = torch.ones_like(log_sparse)
        return Estimate((mean + self.offset) * everywhere, np.log(0.2) * everywhere)

    def forward(self, rgb, log_sparse, trust, last=None, grid=GRID):
        return self.iterate(self.prepare(rgb), log_sparse, trust, last, grid)

    def folded(self, recurrent):
        return copy.deepcopy(self).eval()

    def for_device(self, device, precision, recurrent):
        return self.folded(recurrent).to(device)


@pytest.fixture
def weights(monkeypatch, tmp_path):
    monkeypatch.setitem(REGISTRY, "mean", Entry(MeanNetwork, MeanConfig, old_headers=("Average",)))
    network = MeanNetwork(MeanConfig())
    save_network(tmp_path / "mean.safetensors", network, network.state_dict(), {})
    return tmp_path / "mean.safetensors"


def test_the_completer_runs_it(weights):
    assert isinstance(load_network(weights), DepthNetwork)
    validate_weights(weights, 1)
    with pytest.raises(CompletionError, match="trained for 1 "):
        validate_weights(weights, 2)
    completer = DepthCompleter.load(weights)
    sparse = np.zeros((40, 50), np.float32)
    sparse[3, 4], sparse[30, 9], sparse[20, 41] = 10, 20, 40
    depth, confidence = completer(np.zeros((40, 50, 3), np.uint8), sparse)
    np.testing.assert_allclose(depth, 20, rtol=1e-5)
    np.testing.assert_allclose(confidence, 0.03**2 / (0.03**2 + 0.2**2), rtol=1e-5)
    assert completer.precision == "fp32"
    with pytest.raises(CompletionError, match="auto or fp32"):
        DepthCompleter.load(weights, precision="bf16")


def test_evaluate_judges_it(weights, tmp_path):
    folder = generate(TINY, tmp_path / "phantom", threads=1)
    outputs = Outputs(json=tmp_path / "e.json")
    protocols = [protocol_of("uniform", 50, "none", "per_frame", 0, 1)]
    text = evaluate([folder], [str(weights)], protocols, outputs, None, SilentProgress())
    (record,) = json.loads(outputs.json.read_text())
    assert f"{100 * record['mean']['abs_rel']:.4f}" in text
    assert 0.01 < record["mean"]["abs_rel"] < 1


def test_it_is_trained_on_sfm_points_and_exported(weights, tmp_path):
    rng = np.random.default_rng(0)
    np.save(tmp_path / "images.npy", rng.integers(0, 255, (12, 32, 32, 3), dtype=np.uint8))
    np.save(tmp_path / "depths.npy", rng.uniform(10, 60, (12, 32, 32)).astype(np.float16))
    np.save(tmp_path / "colon.npy", np.repeat(np.arange(6), 2).astype(np.int32))
    config = make_config(model="mean", shards=(tmp_path,), out=tmp_path / "w.safetensors", steps=3, batch=2, warm_up=0)
    trained = load_network(train(config, say=lambda text: None))
    assert isinstance(trained, MeanNetwork)
    assert trained.offset != 0
    assert_onnx_agrees(export_onnx(trained, tmp_path / "m.onnx", 32), trained)


def assert_onnx_agrees(path, network):
    rng = np.random.default_rng(1)
    log_sparse = rng.normal(size=(3, 1, 32, 32)).astype(np.float32)
    inputs = {"rgb": rng.random((3, 3, 32, 32), np.float32), "log_sparse": log_sparse}
    inputs["trust"] = (rng.random(log_sparse.shape) < 0.1).astype(np.float32)
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    named = {one.name for one in session.get_inputs()}
    got = session.run(None, {name: array for name, array in inputs.items() if name in named})
    with torch.inference_mode():
        expected = network(*(torch.from_numpy(array) for array in inputs.values()))
    for a, b in zip(got, expected, strict=True):
        np.testing.assert_allclose(a, b.numpy(), atol=1e-5)


def test_a_weight_file_of_an_older_class_name_is_its(weights, tmp_path):
    old = type("Average", (MeanNetwork,), {})(MeanConfig(0.5))
    save_network(tmp_path / "old.safetensors", old, old.state_dict(), {})
    assert type(load_network(tmp_path / "old.safetensors")) is MeanNetwork
    metric = REGISTRY["unet"].network()
    save_network(tmp_path / "unet.safetensors", metric, metric.state_dict(), {})
    with pytest.raises(CompletionError, match="metric network"):
        DepthCompleter.load(tmp_path / "unet.safetensors")


def test_names_of_earlier_releases_are_read(tmp_path):
    """Class, option, model and setting, as weight files and checkpoints of before the renaming have them."""
    for old, name in (("ScaleFreeMSCSANet", "mscsa-sfm"), ("StDNet", "std18"), ("MSCSAModel", "mscsa")):
        assert described_network(old, {})[0].network is REGISTRY[name].network
    assert described_network("ScaleFreeMSCSANet", {"looks": 3})[1].iterations == 3
    assert with_new_names({"model": "scale-free", "looks": 3}) == {"model": "mscsa-sfm", "iterations": 3}
    assert find_entry("scale-free") is REGISTRY["mscsa-sfm"]
    with pytest.raises(TypeError, match="looks"):
        described_network("MSCSANet", {"looks": 3})
