"""A recorded step computes what one by one is computed; only on CUDA is anything recorded."""

from pathlib import Path

import numpy as np
import pytest
import torch

from completion.data.shards import Shard
from completion.networks.registry import REGISTRY, build_model
from completion.training.config import make_config
from completion.training.recorded_step import WARM_UP, can_record
from completion.training.train import TrainingState, optimise, train_step

# Without StD-50: two runs of it, neither recorded yet, part from the fifth step on by rounding in the order of sums.
RECORDED = ("unet", "mscsa-plain", "mscsa-frame", "early-fusion+sa", "mscsa-early-fusion", "std18", "nlspn")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    np.save(tmp_path / "images.npy", rng.integers(0, 255, (40, 64, 64, 3), dtype=np.uint8))
    np.save(tmp_path / "depths.npy", rng.uniform(10, 60, (40, 64, 64)).astype(np.float16))
    np.save(tmp_path / "colon.npy", np.repeat(np.arange(20), 2).astype(np.int32))
    return tmp_path


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
@pytest.mark.parametrize("model", RECORDED)
def test_recorded_steps_follow_the_same_path(folder: Path, model: str) -> None:
    torch.backends.cudnn.deterministic = True
    losses = []
    for recorded in (True, False):
        config = make_config("paper", shards=(folder,), out=folder / "w", model=model, size="small", learning_rate=1e-4)
        run = TrainingState(config)
        assert run.recorded is not None
        if not recorded:
            task = run.task
            run.recorded = lambda drawn, run=run, task=task: optimise(run, lambda: task.loss_of(drawn))
        shard = Shard.open(folder)
        losses.append([train_step(run, [shard], [shard.split()[0]]) for _ in range(WARM_UP + 20)])
    np.testing.assert_allclose(*losses, rtol=0.02)


def test_networks_that_wait_for_the_gpu_are_not_recorded() -> None:
    cuda = torch.device("cuda")
    refused = set()
    for name, entry in REGISTRY.items():
        if entry.is_metric:
            with torch.device("meta"):
                network = build_model(name, "small")
            assert not can_record(network, torch.device("cpu"))
            refused |= set() if can_record(network, cuda) else {name}
    assert refused == {"gaenet", "mscsa-frozen"}
