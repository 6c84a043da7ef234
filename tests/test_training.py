"""Two steps of training on made-up shards; stopping in between changes nothing; wrong weight files are named."""

import numpy as np
import pytest
import torch

from completion.checkpoint import load_network, load_tensors, save_network, save_tensors
from completion.errors import CompletionError
from completion.infer import DepthCompleter
from completion.network import MSCSANet, ScaleFreeConfig, ScaleFreeMSCSANet
from completion.train import TrainConfig, train


@pytest.fixture
def shards(tmp_path):
    rng = np.random.default_rng(0)
    folder = tmp_path / "shards"
    folder.mkdir()
    np.save(folder / "images.npy", rng.integers(0, 255, (12, 64, 64, 3), dtype=np.uint8))
    np.save(folder / "depths.npy", rng.uniform(10, 60, (12, 64, 64)).astype(np.float16))
    np.save(folder / "colon.npy", np.repeat(np.arange(6), 2).astype(np.int32))
    return folder


def config(shards, out, **changes):
    return TrainConfig(shards=(shards,), out=out, batch=2, width=4, warm_up=1, threads=1, **changes)


def test_training_is_repeatable_and_resumes(shards, tmp_path):
    whole = train(config(shards, tmp_path / "a.safetensors", steps=4))
    again = train(config(shards, tmp_path / "b.safetensors", steps=4))
    for name, tensor in load_tensors(whole)[0].items():
        assert torch.equal(tensor, load_tensors(again)[0][name]), name
    first = load_network(whole)
    assert isinstance(first, ScaleFreeMSCSANet)
    # A checkpoint of the finished run: resuming it trains no further and writes the same weights.
    before = whole.read_bytes()
    assert train(config(shards, whole, steps=4)).read_bytes() == before
    with pytest.raises(CompletionError, match="other settings"):
        train(config(shards, whole, steps=4, seed=1))


def test_a_stopped_training_ends_like_an_unbroken_one(shards, tmp_path, monkeypatch):
    import completion.train as module

    unbroken = train(config(shards, tmp_path / "a.safetensors", steps=4))
    calls = []
    original = module.forward_loss

    def stop_at_the_third(*arguments):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return original(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(module, "forward_loss", stop_at_the_third)
        with pytest.raises(KeyboardInterrupt):
            train(config(shards, tmp_path / "b.safetensors", steps=4, checkpoint_seconds=0))
    resumed = train(config(shards, tmp_path / "b.safetensors", steps=4, checkpoint_seconds=0))
    for name, tensor in load_tensors(unbroken)[0].items():
        assert torch.equal(tensor, load_tensors(resumed)[0][name]), name


def test_wrong_weight_files_are_one_sentence(tmp_path):
    path = tmp_path / "w.safetensors"
    save_tensors(path, {"a": torch.zeros(1)}, {"network": "GPT", "config": {}})
    with pytest.raises(CompletionError, match="holds a GPT"):
        load_network(path)
    network = ScaleFreeMSCSANet(ScaleFreeConfig(width=4))
    weights = network.state_dict()
    weights.pop("unet.head.bias")
    save_network(path, network, weights, {})
    with pytest.raises(CompletionError, match="do not fit ScaleFreeMSCSANet"):
        load_network(path)
    metric = MSCSANet()
    save_network(path, metric, metric.state_dict(), {})
    with pytest.raises(CompletionError, match="metric network"):
        DepthCompleter.load(path)


def test_the_shipped_weights_load_and_beat_the_median():
    """On a rendered-like ramp the shipped model is far better than a constant."""
    completer = DepthCompleter.load("mscsa")
    rows, columns = np.mgrid[:128, :128]
    truth = (15 + 0.3 * columns + 0.1 * rows).astype(np.float32)
    rgb = np.clip(4e4 / truth**2, 0, 255)[..., None].repeat(3, 2).astype(np.uint8)
    rng = np.random.default_rng(0)
    sparse = np.where(rng.random(truth.shape) < 0.01, truth, 0).astype(np.float32)
    depth, confidence = completer(rgb, sparse)
    assert (np.abs(depth - truth) / truth).mean() < 0.05
    assert 0.05 < confidence.mean() <= 1
