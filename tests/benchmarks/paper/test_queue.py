"""The queue: its plan, that finished runs are left out, and how a run is judged."""

import json

import numpy as np
import pytest
import torch
from torch import nn

from benchmarks.paper import figures, frames, run_queue, single_run
from benchmarks.paper.batch_statistics import companion_effect
from benchmarks.paper.frames import render
from benchmarks.paper.plan import BOTH, CHANGES, FLOAT32, JUDGED_THRICE, SCENES, TRAINED_ON, UNTRAINED, Run, tables
from completion.evaluation.metrics import depth_errors
from completion.evaluation.predictors import Predictor, load_predictor
from completion.networks.registry import REGISTRY
from completion.training.config import make_config


def test_runs_have_names_of_their_own_and_networks_that_exist():
    runs = [run for table in tables().values() for run in table.runs]
    assert len({run.name for run in runs}) == len(set(runs))
    assert {run.model for run in runs} <= set(REGISTRY) | set(UNTRAINED)
    assert {run.change for run in runs} == {"", *CHANGES, *BOTH, *JUDGED_THRICE}
    seeds = [seed for pair in SCENES.values() for seed in pair]
    assert len(set(seeds)) == len(seeds)  # frames of one seed share meshes


def test_a_stopped_queue_leaves_out_what_has_a_record(tmp_path, monkeypatch, capsys):
    runs = tables()["untrained"].runs
    done = []

    def performed(run, work, environment):
        done.append(run)
        if len(done) == 3:
            raise KeyboardInterrupt
        judged = {"abs_rel": [0.1, 0.3]}
        about = {"failed": None, "environment": environment, "seconds_a_step": None}
        return about | {"model": run.model, "scenes": {run.scenes[0]: {"frames": judged}}}

    monkeypatch.setattr(single_run, "perform", performed)
    monkeypatch.setattr(frames, "render", lambda work, scene, side: None)
    command = ["paper", "--work", str(tmp_path / "work"), "--results", str(tmp_path / "records")]
    monkeypatch.setattr("sys.argv", [*command, "--table", "untrained"])
    with pytest.raises(SystemExit, match="stopped; the same command goes on"):
        run_queue.main()
    run_queue.main()
    assert done == [*runs[:3], *runs[2:]]
    said = capsys.readouterr().out
    assert f"{len(runs)} runs have no record in {tmp_path / 'records'}: at most 0 steps" in said
    assert len(list((tmp_path / "records").glob("*.json"))) == len(runs)


@pytest.fixture
def folder(tmp_path):
    """Six frames of three meshes."""
    rng = np.random.default_rng(0)
    np.save(tmp_path / "images.npy", rng.integers(0, 255, (6, 64, 64, 3), dtype=np.uint8))
    np.save(tmp_path / "depths.npy", rng.uniform(10, 60, (6, 64, 64)).astype(np.float16))
    np.save(tmp_path / "colon.npy", np.repeat([0, 1, 2], 2).astype(np.int32))
    return tmp_path


def test_every_frame_is_judged_against_its_own_truth(folder):
    config = make_config("paper", shards=(folder,), out=folder / "w", points=50)
    truth = np.load(folder / "depths.npy").astype(np.float32)
    found = single_run.judged(folder, load_predictor("linear"), config)
    assert found["frames"]["mesh"] == [0, 0, 1, 1, 2, 2]
    assert found["batch_statistics"] is None
    constant = Predictor(lambda rgb, sparse, lens: (np.full_like(sparse, 30.0), None))
    judged = single_run.judged(folder, constant, config)["frames"]
    expected = [depth_errors(np.full((64, 64), 30.0), depth).abs_rel for depth in truth]
    np.testing.assert_allclose(judged["abs_rel"], expected, atol=1e-6)


class Scaled(nn.Module):
    """Hands on the mean of the points times a gain; with `norm`, the gain depends on the batch."""

    def __init__(self, norm: bool) -> None:
        super().__init__()
        self.norm = nn.BatchNorm2d(1) if norm else nn.Identity()
        self.unused = nn.BatchNorm2d(1)

    def forward(self, rgb, sparse, lens=None):
        mean = sparse.sum((2, 3), keepdim=True) / (sparse > 0).sum((2, 3), keepdim=True)
        return 2 + self.norm(mean.expand(-1, -1, 8, 8)).mean((2, 3), keepdim=True).expand_as(sparse)


def test_companions_matter_only_where_the_batch_normalises(folder, monkeypatch):
    monkeypatch.setattr("benchmarks.paper.batch_statistics.BATCH", 3)
    rng = np.random.default_rng(1)
    flat = np.repeat(rng.uniform(10, 60, (6, 1, 1)), 64, axis=1).repeat(64, axis=2)
    np.save(folder / "depths.npy", flat.astype(np.float16))
    effects = [companion_effect(Scaled(norm).eval(), folder, 25.0, 50) for norm in (False, True)]
    assert effects[0] is not None
    assert effects[0]["companions"] == pytest.approx(0, abs=1e-6)
    assert effects[1] is not None
    assert effects[1]["companions"] > 0.01
    assert companion_effect(nn.Conv2d(1, 1, 1), folder, 25.0, 50) is None


def test_the_running_statistics_stay_as_they_are(folder, monkeypatch):
    monkeypatch.setattr("benchmarks.paper.batch_statistics.BATCH", 3)
    network = Scaled(True).eval()
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    companion_effect(network, folder, 25.0, 50)
    assert torch.equal(network.norm.running_mean, before["norm.running_mean"])
    assert torch.equal(network.norm.running_var, before["norm.running_var"])
    assert not network.norm.training


def test_frames_of_another_plan_are_refused(tmp_path):
    for name in ("colon", "colon_judged"):
        (tmp_path / name).mkdir()
        about = {"frames": 7, "size": 160, "seed": 51, "scene": "colon"}
        (tmp_path / name / "shards.json").write_text(json.dumps(about))
    with pytest.raises(SystemExit, match="other frames"):
        render(tmp_path, "colon")


def test_a_run_with_a_change_has_other_settings():
    plain, changed = (Run(("colon",), "unet", change=change) for change in ("", "float32"))
    assert plain.settings | {"bf16": False} == changed.settings
    assert plain.name != changed.name


def test_runs_that_differ_in_how_they_are_judged_share_weights_and_are_not_trained_at_once():
    runs = [Run(("colon",), "mscsa-early-fusion", change=change) for change in ("", FLOAT32, TRAINED_ON, "float32")]
    assert len({run.name for run in runs}) == 4
    assert len({run.weights for run in runs}) == 2
    order = []
    run_queue.perform_all(lambda run: order.append(run) or run.name, [runs[0], runs[3], runs[2], runs[1]], 1)
    assert order == [runs[0], runs[2], runs[1], runs[3]]


def test_a_network_is_judged_by_its_trained_weights_or_on_its_training_frames(tmp_path, monkeypatch):
    """The same training, three judgements: half precision moves a figure a little, frames trained on a lot."""
    rng = np.random.default_rng(0)
    for name in ("colon", "colon_judged"):
        (tmp_path / name).mkdir()
        np.save(tmp_path / name / "images.npy", rng.integers(0, 255, (40, 32, 32, 3), dtype=np.uint8))
        np.save(tmp_path / name / "depths.npy", rng.uniform(10, 60, (40, 32, 32)).astype(np.float16))
        np.save(tmp_path / name / "colon.npy", np.repeat(np.arange(20), 2).astype(np.int32))
        np.save(tmp_path / name / "intrinsics.npy", np.full((40, 4), 16, np.float32))
    monkeypatch.setattr(single_run, "render", lambda work, scene, side: (work / scene, work / f"{scene}_judged"))
    monkeypatch.setattr(frames, "JUDGED_FRAMES", 10)
    found = {}
    for change in ("", FLOAT32, TRAINED_ON):
        run = Run(("colon",), "mscsa-early-fusion+half-width", change=change, steps=3)
        found[change] = single_run.perform(run, tmp_path, {})
    assert [record["steps_on"] for record in found.values()] == [{"cpu": 3}] * 3
    errors = {change: np.array(record["scenes"]["colon"]["frames"]["abs_rel"]) for change, record in found.items()}
    assert 0 < np.abs(errors[""] - errors[FLOAT32]).max() < 0.01
    assert len(errors[TRAINED_ON]) == 10
    assert max(found[TRAINED_ON]["scenes"]["colon"]["frames"]["mesh"]) < 19  # the last mesh is held out


def test_a_figure_without_its_networks_is_refused_and_replaces_nothing(tmp_path, monkeypatch):
    record = tmp_path / "figures.json"
    record.write_text("{}")
    command = ["figures", "--work", str(tmp_path), "--pictures", str(tmp_path), "--json", str(record), "--figure", "4"]
    monkeypatch.setattr("sys.argv", command)
    with pytest.raises(SystemExit, match=r"Figure 4 needs 8 trained networks; .* lacks 8, .*--results OTHER --table 1"):
        figures.main()
    assert [path.name for path in tmp_path.iterdir()] == ["figures.json"]
    assert record.read_text() == "{}"
