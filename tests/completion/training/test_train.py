"""Two steps of training on made-up shards; stopping in between changes nothing; wrong weight files are named."""

import csv
import signal
import subprocess
import sys

import numpy as np
import pytest
import torch

from completion.data.shards import Batch, Shard, augment
from completion.evaluation.predictors import load_predictor
from completion.inference.completer import DepthCompleter, load_depth_network
from completion.networks.checkpoint import load_network, load_tensors, save_network, save_tensors
from completion.networks.mscsa import MSCSANet
from completion.networks.mscsa_sfm import ScaleInvariantConfig, ScaleInvariantMSCSANet
from completion.training.batches import draw_batch
from completion.training.config import TrainConfig, make_config
from completion.training.distributed import ProcessGroup
from completion.training.graceful_interrupt import GracefulInterrupt
from completion.training.log import TrainLog
from completion.training.train import LATER_SETTINGS, TrainingState, learning_rate, train
from haustra.core.errors import CompletionError


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
    return TrainConfig(shards=(shards,), out=out, width=4, warm_up=1, threads=1, **{"batch": 2, **changes})


def test_training_is_repeatable_and_resumes(shards, tmp_path):
    whole = train(config(shards, tmp_path / "a.safetensors", steps=4))
    again = train(config(shards, tmp_path / "b.safetensors", steps=4))
    for name, tensor in load_tensors(whole)[0].items():
        assert torch.equal(tensor, load_tensors(again)[0][name]), name
    assert [row["step"] for row in csv.DictReader(whole.with_suffix(".log.csv").open())] == ["4"]  # a short run's too
    first = load_network(whole)
    assert isinstance(first, ScaleInvariantMSCSANet)
    # A checkpoint of the finished run: resuming it trains no further and writes the same weights.
    before = whole.read_bytes()
    assert train(config(shards, whole, steps=4)).read_bytes() == before
    assert whole.stat().st_mode == (shards / "colon.npy").stat().st_mode  # readable as other files are
    with pytest.raises(CompletionError, match="of a run with other batch, seed; give another"):
        train(config(shards, whole, steps=4, seed=1, batch=4))


def test_a_run_goes_on_where_its_frames_were_moved_to_and_with_no_others(shards, tmp_path):
    out = tmp_path / "a.safetensors"
    before = train(config(shards, out, steps=2)).read_bytes()
    moved = shards.rename(tmp_path / "elsewhere")
    assert train(config(moved, out, steps=2)).read_bytes() == before
    checkpoint = out.with_suffix(".checkpoint")
    tensors, about = load_tensors(checkpoint)
    about["config"]["shards"] = ["/of/a/machine/elsewhere"]  # as older versions wrote it
    for name in LATER_SETTINGS:
        del about["config"][name]
    save_tensors(checkpoint, tensors, about)
    assert train(config(moved, out, steps=2)).read_bytes() == before
    np.save(moved / "depths.npy", np.load(moved / "depths.npy") + np.float16(1))
    save_tensors(checkpoint, *load_tensors(checkpoint))
    with pytest.raises(CompletionError, match="of a run with other shards"):
        train(config(moved, out, steps=2))


def test_the_log_is_the_same_in_csv_and_in_tensorboard(tmp_path):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    lines = []
    log = TrainLog(tmp_path / "w.safetensors", lines.append)
    log.write(100, 200, 0.5, 1e-3, None)
    log.write(200, 200, 0.25, 1e-4, 0.08)
    assert lines[1] == "step 200/200  loss 0.2500  held-out abs.REL 8.00 %"
    rows = list(csv.DictReader((tmp_path / "w.log.csv").open()))
    events = EventAccumulator(str(tmp_path / "w.tensorboard")).Reload()
    for name in ("loss", "learning_rate", "held_out_abs_rel"):
        in_csv = {int(row["step"]): float(row[name]) for row in rows if row[name]}
        assert {e.step: e.value for e in events.Scalars(name)} == pytest.approx(in_csv, rel=1e-6)


@pytest.mark.slow
def test_two_processes_take_the_step_that_one_would_take_with_both_gradients(shards, tmp_path):
    """Oracle: the mean of the two halves' gradients, put together by hand in one process."""
    values = {"steps": 1, "augmentation": False, "ema": 0.0, "bf16": False, "warm_up": 0}
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    script = tmp_path / "two.py"
    given = {"shards": [str(shards)], "out": str(tmp_path / "two.safetensors"), **values}
    script.write_text(
        "from completion.training.train import train\nfrom completion.training.config import make_config\n"
        f"train(make_config(None, width=4, batch=2, threads=1, **{given!r}))\n"
    )
    subprocess.run([*torchrun, str(script)], check=True, capture_output=True, timeout=300)
    alone = TrainingState(
        make_config(None, width=4, batch=2, threads=1, shards=(shards,), out=tmp_path / "one", **values)
    )
    fresh = {name: b.clone() for name, b in alone.task.network.named_buffers() if b.is_floating_point()}
    gradients, statistics = [], {name: torch.zeros_like(b) for name, b in fresh.items()}
    for rank in (0, 1):
        for name, buffer in alone.task.network.named_buffers():
            if name in fresh:
                buffer.copy_(fresh[name])
        opened = Shard.open(shards)
        batch, generator = draw_batch(
            alone.config, 0, [opened], [opened.split()[0]], ProcessGroup(rank, 2), alone.device
        )
        assert len(batch.rgb) == 1
        alone.task.network.zero_grad()
        alone.task.loss(batch.to(alone.device).rgb, batch.depth, None, generator).backward()
        for name, buffer in alone.task.network.named_buffers():
            if name in fresh:
                statistics[name] += buffer / 2
        gradients.append([None if p.grad is None else p.grad.clone() for p in alone.task.network.parameters()])
    for parameter, *both in zip(alone.task.network.parameters(), *gradients, strict=True):
        parameter.grad = None if both[0] is None else (both[0] + both[1]) / 2
    for group in alone.optimizer.param_groups:
        group["lr"] = learning_rate(0, alone.config)
    torch.nn.utils.clip_grad_norm_(alone.task.network.parameters(), 1.0)
    alone.optimizer.step()
    together = load_tensors(tmp_path / "two.checkpoint")[0]
    for name, mean in statistics.items():
        torch.testing.assert_close(together[f"network.{name}"], mean, rtol=1e-4, atol=1e-5)
    compared, elements = 0, 0
    for name, parameter in alone.task.network.named_parameters():
        # Adam's first step is the gradient's sign, but where that is as small as Adam's epsilon (1e-8) rounding shows.
        clear = torch.ones_like(parameter, dtype=torch.bool) if parameter.grad is None else parameter.grad.abs() > 1e-6
        compared, elements = compared + int(clear.sum()), elements + clear.numel()
        of_two, of_one = together[f"network.{name}"][clear], parameter.detach()[clear]
        torch.testing.assert_close(of_two, of_one, rtol=1e-4, atol=1e-6)
    assert compared > 0.9 * elements


@pytest.mark.parametrize("model", ["mscsa-sfm", pytest.param("gaenet", marks=pytest.mark.slow)])
def test_a_stopped_training_ends_like_an_unbroken_one(shards, tmp_path, monkeypatch, model):
    import completion.training.train as module

    def settings(name, **more):
        kind = {} if model == "mscsa-sfm" else {"model": model, "size": "small"}  # GAENet drops out at random
        return config(shards, tmp_path / name, steps=4, **kind, **more)

    np.save(shards / "intrinsics.npy", np.tile(np.float32([60, 60, 32, 32]), (12, 1)))
    unbroken = train(settings("a.safetensors"))
    calls = []
    original = module.train_step

    def stop_at_the_third(*arguments):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return original(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(module, "train_step", stop_at_the_third)
        with pytest.raises(KeyboardInterrupt):
            train(settings("b.safetensors", checkpoint_seconds=0))
    said: list[str] = []
    resumed = train(settings("b.safetensors", checkpoint_seconds=0), say=said.append)
    assert said[0].startswith("going on from step 2 of 4")
    for name, tensor in load_tensors(unbroken)[0].items():
        assert torch.equal(tensor, load_tensors(resumed)[0][name]), name


def test_ctrl_c_ends_the_step_and_saves_it(shards, tmp_path):
    """No checkpoint was due; a second Ctrl-C would not wait."""
    before = signal.getsignal(signal.SIGINT)
    unbroken = train(config(shards, tmp_path / "a.safetensors", steps=4))

    def stop_at_the_third(step, steps):
        if step == 3:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        train(config(shards, tmp_path / "b.safetensors", steps=4), advance=stop_at_the_third)
    assert signal.getsignal(signal.SIGINT) == before
    said: list[str] = []
    resumed = train(config(shards, tmp_path / "b.safetensors", steps=4), say=said.append)
    assert said[0].startswith("going on from step 3 of 4")
    assert load_tensors(tmp_path / "b.checkpoint")[1]["steps_on"] == {"cpu": 4}
    for name, tensor in load_tensors(unbroken)[0].items():
        assert torch.equal(tensor, load_tensors(resumed)[0][name]), name
    with GracefulInterrupt() as interrupt:
        signal.raise_signal(signal.SIGINT)
        assert interrupt.requested
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_wrong_weight_files_are_one_sentence(tmp_path):
    path = tmp_path / "w.safetensors"
    save_tensors(path, {"a": torch.zeros(1)}, {"network": "GPT", "config": {}})
    with pytest.raises(CompletionError, match="holds a GPT"):
        load_network(path)
    network = ScaleInvariantMSCSANet(ScaleInvariantConfig(width=4))
    weights = network.state_dict()
    weights.pop("unet.head.bias")
    save_network(path, network, weights, {})
    with pytest.raises(CompletionError, match="do not fit ScaleInvariantMSCSANet"):
        load_network(path)
    metric = MSCSANet()
    save_network(path, metric, metric.state_dict(), {})
    with pytest.raises(CompletionError, match="metric network"):
        DepthCompleter.load(path)


@pytest.mark.parametrize("iterations", [1, 2, 3])
def test_the_shipped_weights_load_and_beat_the_median(iterations):
    """On a rendered-like ramp the shipped model is far better than a constant, whatever the number of iterations."""
    completer = DepthCompleter(load_depth_network("mscsa"), iterations=iterations)
    rows, columns = np.mgrid[:128, :128]
    truth = (15 + 0.3 * columns + 0.1 * rows).astype(np.float32)
    rgb = np.clip(4e4 / truth**2, 0, 255)[..., None].repeat(3, 2).astype(np.uint8)
    rng = np.random.default_rng(0)
    sparse = np.where(rng.random(truth.shape) < 0.01, truth, 0).astype(np.float32)
    depth, confidence = completer(rgb, sparse)
    assert (np.abs(depth - truth) / truth).mean() < 0.05
    assert 0.05 < confidence.mean() <= 1


@pytest.mark.parametrize(
    "model", ["mscsa", *(pytest.param(rival, marks=pytest.mark.slow) for rival in ("std18", "gaenet", "nlspn"))]
)
def test_every_network_trains_by_the_paper_preset_and_is_evaluated_in_its_unit(shards, tmp_path, model):
    np.save(shards / "intrinsics.npy", np.tile(np.float32([40, 40, 32, 32]), (12, 1)))
    settings = make_config(
        "paper", shards=(shards,), out=tmp_path / "w.safetensors", model=model, size="small", steps=2
    )
    assert (settings.batch, settings.optimizer, settings.learning_rate) == (10, "adam", 1e-3)
    path = train(settings.model_copy(update={"threads": 1}))
    rgb = np.load(shards / "images.npy")[0]
    sparse = np.zeros((64, 64), np.float32)
    sparse[::8, ::8] = 30
    depth, confidence = load_predictor(path)(rgb, sparse, np.array([40.0, 40, 32, 32]))
    assert depth.shape == (64, 64)
    assert confidence is None
    assert np.isfinite(depth).all()
    network = load_network(path)
    with torch.inference_mode():
        image = torch.from_numpy(rgb).permute(2, 0, 1)[None].float() / 255
        lens = torch.tensor([[40.0, 40, 32, 32]])
        direct = network(image, torch.from_numpy(sparse)[None, None] / 25, lens)[0, 0].numpy() * 25
    np.testing.assert_allclose(depth, direct, rtol=1e-4, atol=1e-3)


def test_a_flipped_lens_still_projects_the_flipped_frame():
    rays = torch.rand(3, 1, 5, 7, generator=torch.Generator().manual_seed(0))
    depth = torch.arange(35.0).view(1, 1, 5, 7) + 1
    lens = torch.tensor([[4.0, 5.0, 3.1, 2.2]])
    for seed in range(8):
        out = augment(Batch(rays.permute(1, 0, 2, 3), depth, lens), torch.Generator().manual_seed(seed))
        # Pixel (2, 3) of the original, enlarged or not: the middle of what shows its depth.
        r, c = [(int(v.min()) + int(v.max()) + 1) / 2 for v in torch.where(out.depth[0, 0] == 18)]
        x, y = (c - out.lens[0, 2]) / out.lens[0, 0], (r - out.lens[0, 3]) / out.lens[0, 1]
        grown = out.lens[0, :2] / lens[0, :2]  # nearest pixels lie up to half a pixel off
        assert abs(abs(x) - abs(3.5 - 3.1) / 4) < (0.51 if grown[0] > 1 else 1e-6) / out.lens[0, 0]
        assert abs(abs(y) - abs(2.5 - 2.2) / 5) < (0.51 if grown[1] > 1 else 1e-6) / out.lens[0, 1]


def test_training_starts_from_given_weights_and_refuses_others(shards, tmp_path):
    first = train(config(shards, tmp_path / "a.safetensors", steps=2))
    again = config(shards, tmp_path / "b.safetensors", steps=1, init=first, learning_rate=1e-12)
    start, end = load_network(first), load_network(train(again))
    for name, tensor in end.named_parameters():
        torch.testing.assert_close(tensor, dict(start.named_parameters())[name], atol=2e-3, rtol=2e-3)
    with pytest.raises(CompletionError, match="do not fit"):
        train(config(shards, tmp_path / "c.safetensors", steps=1, init=first).model_copy(update={"width": 8}))
    with pytest.raises(CompletionError, match="holds a ScaleInvariant"):
        train(config(shards, tmp_path / "d.safetensors", steps=1, init=first, model="unet", size="small"))


def test_wrong_settings_are_one_sentence(shards, tmp_path):
    with pytest.raises(CompletionError, match="training setting steps"):
        make_config(shards=(shards,), out=tmp_path / "w", steps=0)
    with pytest.raises(CompletionError, match="no preset"):
        make_config("fast", shards=(shards,), out=tmp_path / "w")
    with pytest.raises(CompletionError, match="fewer than a batch"):
        train(make_config(shards=(shards,), out=tmp_path / "w", batch=400, steps=1))
    with pytest.raises(CompletionError, match="gaenet needs"):
        train(make_config(shards=(shards,), out=tmp_path / "w", batch=2, steps=1, model="gaenet", size="small"))
