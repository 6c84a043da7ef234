"""The rate after each third, MSC trained first, and checkpoints that were written before a setting existed."""

from pathlib import Path

import numpy as np
import pytest
import torch

from completion.data.shards import Shard
from completion.networks.checkpoint import load_tensors, save_tensors
from completion.training.config import make_config
from completion.training.train import TrainingState, learning_rate, train, train_step
from haustra.core.errors import CompletionError


def test_the_rate_falls_to_a_tenth_after_each_third(tmp_path: Path) -> None:
    config = make_config("paper", shards=(), out=tmp_path / "w", steps=9, schedule="thirds", learning_rate=1.0)
    rates = [learning_rate(step, config) for step in range(9)]
    assert rates == pytest.approx([1, 1, 1, 0.1, 0.1, 0.1, 0.01, 0.01, 0.01])


def test_msc_learns_first_and_is_then_held_fixed(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    np.save(tmp_path / "images.npy", rng.integers(0, 255, (40, 64, 64, 3), dtype=np.uint8))
    np.save(tmp_path / "depths.npy", rng.uniform(10, 60, (40, 64, 64)).astype(np.float16))
    np.save(tmp_path / "colon.npy", np.repeat(np.arange(20), 2).astype(np.int32))
    config = make_config("paper", shards=(tmp_path,), out=tmp_path / "w", model="mscsa-early-fusion", msc_first=2)
    run, shard = TrainingState(config), Shard.open(tmp_path)
    for step in range(4):
        before = {name: tensor.clone() for name, tensor in run.task.network.state_dict().items()}
        train_step(run, [shard], [shard.split()[0]])
        after = run.task.network.state_dict()
        changed = {name.startswith("msc.") for name in before if not torch.equal(before[name], after[name])}
        assert changed == {step < 2}
    with pytest.raises(CompletionError, match="no multi-scale confidence"):
        TrainingState(config.model_copy(update={"model": "early-fusion"}))


def test_a_checkpoint_without_the_norm_of_clipping_is_one_of_norm_1(tmp_path: Path) -> None:
    config = make_config("paper", shards=(), out=tmp_path / "w.safetensors", model="unet", size="small")
    run = TrainingState(config)
    run.step = 7
    run.save()
    tensors, metadata = load_tensors(run.checkpoint)
    del metadata["config"]["clip"]
    save_tensors(run.checkpoint, tensors, metadata)
    again = TrainingState(config)
    again.resume()
    assert again.step == 7
    other = TrainingState(config.model_copy(update={"clip": 0.0}))
    with pytest.raises(CompletionError, match="other clip"):
        other.resume()


@pytest.mark.parametrize(
    ("colon", "said"),
    [
        (
            [3] * 6,
            "has 6 frames of 1 mesh: whole meshes are held out to measure the error on, so two or more are needed",
        ),
        ([], "has 0 frames of 0 meshes"),
        (
            [0, 0, 1, 1, 1],
            "has 2 frames to train on, fewer than a batch of 4: 3 of its 5, those of 1 of 2 meshes, are held",
        ),
        ([0, 0, 0, 0, 1], None),
    ],
)
def test_frames_of_too_few_meshes_are_told_with_what_is_held_out(
    tmp_path: Path, colon: list[int], said: str | None
) -> None:
    np.save(tmp_path / "images.npy", np.zeros((len(colon), 32, 32, 3), np.uint8))
    np.save(tmp_path / "depths.npy", np.zeros((len(colon), 32, 32), np.float16))
    np.save(tmp_path / "colon.npy", np.array(colon, np.int32))
    config = make_config(shards=(tmp_path,), out=tmp_path / "w", batch=4, steps=1)
    if said is None:
        assert Shard.open(tmp_path).too_few_for(4) == ""
    else:
        with pytest.raises(CompletionError, match=said):
            train(config)
