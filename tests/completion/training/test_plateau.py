"""When a run of unknown length ends."""

from pathlib import Path

import numpy as np
import pytest

from completion.networks.checkpoint import load_tensors
from completion.training import plateau
from completion.training.config import make_config
from completion.training.plateau import EVERY, PATIENCE, Plateau
from completion.training.train import TrainingState, train


def test_the_full_rate_ends_when_the_error_stops_falling() -> None:
    run = Plateau(9000)
    errors = [0.5, 0.4, 0.3, 0.31, 0.299, 0.298, 0.33, 0.296, 0.1]
    for index, error in enumerate(errors, start=1):
        run.update(index * EVERY, error)
        assert bool(run.cooled_at) == (index >= 3 + PATIENCE)
    assert run.cooled_at == (3 + PATIENCE) * EVERY
    assert run.steps == round(run.cooled_at * 4 / 3)


def test_cooling_fits_into_the_most_steps() -> None:
    run, error = Plateau(1200), 1.0
    for step in range(EVERY, 1201, EVERY):
        run.update(step, error := error / 2)
        if run.cooled_at:
            break
    assert run.cooled_at == 1000
    assert run.steps == 1200


@pytest.mark.slow
def test_a_stopped_run_goes_on_to_the_same_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    np.save(tmp_path / "images.npy", rng.integers(0, 255, (40, 32, 32, 3), dtype=np.uint8))
    np.save(tmp_path / "depths.npy", rng.uniform(10, 60, (40, 32, 32)).astype(np.float16))
    np.save(tmp_path / "colon.npy", np.repeat(np.arange(20), 2).astype(np.int32))
    monkeypatch.setattr("completion.training.train.PLATEAU_EVERY", 2)
    monkeypatch.setattr("completion.training.train.LOG_EVERY", 2)
    monkeypatch.setattr(plateau, "PATIENCE", 2)
    config = make_config(
        "paper", shards=(tmp_path,), out=tmp_path / "a", model="early-fusion", schedule="plateau", steps=40
    )
    train(config, say=lambda _: None)
    whole, about = load_tensors(TrainingState(config).checkpoint)
    assert about["step"] == Plateau(**about["plateau"]).steps < 40
    other = config.model_copy(update={"out": tmp_path / "b", "checkpoint_seconds": 0.0})

    def stop(step: int, steps: int | None) -> None:
        if step == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(other, stop, say=lambda _: None)
    assert load_tensors(TrainingState(other).checkpoint)[1]["step"] == 4
    train(other, say=lambda _: None)
    again, _ = load_tensors(TrainingState(other).checkpoint)
    assert all(np.array_equal(whole[name].numpy(), again[name].numpy()) for name in whole)
