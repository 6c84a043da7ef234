"""The rate after each third, and checkpoints that were written before a setting existed."""

from pathlib import Path

import pytest

from completion.networks.checkpoint import load_tensors, save_tensors
from completion.training.config import make_config
from completion.training.train import TrainingState, learning_rate
from haustra.core.errors import CompletionError


def test_the_rate_falls_to_a_tenth_after_each_third(tmp_path: Path) -> None:
    config = make_config("paper", shards=(), out=tmp_path / "w", steps=9, schedule="thirds", learning_rate=1.0)
    rates = [learning_rate(step, config) for step in range(9)]
    assert rates == pytest.approx([1, 1, 1, 0.1, 0.1, 0.1, 0.01, 0.01, 0.01])


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
