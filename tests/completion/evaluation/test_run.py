"""Samplers' exact counts and noise, evaluation by protocol, and the command from end to end."""

from __future__ import annotations

import csv
import json
import re
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from completion.confidence import confidence_from_error, error_from_confidence
from completion.data.evaluation_frame import EvaluationFrame
from completion.data.sampling_benchmark import features, like_sfm, uniform
from completion.evaluation.accumulator import Accumulator
from completion.evaluation.evaluate import LeftOut, Protocol, evaluate_frames, mean_errors
from completion.evaluation.outputs import Outputs
from completion.evaluation.plots import KINDS, sweep_plot
from completion.evaluation.predictors import load_predictor
from completion.evaluation.run import _with_gaps, evaluate, protocol_of
from completion.inference.completer import choose_device
from completion.networks.precision import choose_precision
from haustra.core.errors import CompletionError
from haustra.core.progress import SilentProgress
from haustra.phantom.config import EventsConfig
from haustra.phantom.dataset.generate import generate
from tests.helpers.tiny_phantom import TINY


def frame(size: int = 64) -> EvaluationFrame:
    rng = np.random.default_rng(0)
    rgb = np.kron(rng.integers(0, 255, (size // 4, size // 4, 3)), np.ones((4, 4, 1))).astype(np.uint8)
    y, x = np.mgrid[:size, :size]
    depth = (20 + 0.2 * x + 0.1 * y).astype(np.float32)
    depth[:8] = 0
    return EvaluationFrame("0", rgb, depth, "mm")


@pytest.mark.parametrize("points", [1, 10, 300])
@pytest.mark.parametrize("sampler", [uniform, features])
def test_counts_are_exact_depths_true_and_seeds_repeat(sampler, points: int) -> None:
    view = frame()
    sparse = sampler(view.rgb, view.depth, points, np.random.default_rng(1))
    chosen = sparse.depth > 0
    assert chosen.sum() == points
    np.testing.assert_array_equal(sparse.depth[chosen], view.depth[chosen])
    again = sampler(view.rgb, view.depth, points, np.random.default_rng(1))
    np.testing.assert_array_equal(again.depth, sparse.depth)


def test_features_sit_on_what_can_be_tracked() -> None:
    y, x = np.mgrid[:96, :96]
    dots = [(r, c) for r in range(16, 96, 16) for c in range(16, 96, 16)]
    grey = 60 + sum(150 * np.exp(-((y - r) ** 2 + (x - c) ** 2) / 8.0) for r, c in dots)
    rgb = np.repeat(grey.clip(0, 255).astype(np.uint8)[..., None], 3, axis=-1)
    depth = np.full((96, 96), 30, np.float32)

    def distance_to_dots(sampler) -> float:
        places = np.argwhere(sampler(rgb, depth, len(dots), np.random.default_rng(0)).depth > 0)
        return float(np.mean(np.min(np.linalg.norm(places[:, None] - np.array(dots)[None], axis=-1), axis=1)))

    assert distance_to_dots(features) < 2.0
    assert distance_to_dots(uniform) > 4.0


def test_sfm_points_have_the_stated_noise_outliers_and_factor() -> None:
    view = frame(256)
    ratios, factors = [], []
    for seed in range(12):
        sparse = like_sfm(view.rgb, view.depth, 400, np.random.default_rng(seed))
        chosen = sparse.depth > 0
        ratios.append(sparse.depth[chosen] / sparse.factor / view.depth[chosen])
        factors.append(sparse.factor)
    ratio = np.concatenate(ratios)
    assert len(ratio) > 2000
    core = np.abs(ratio - 1) < 0.12
    assert 0.005 < 1 - core.mean() < 0.05  # 3 % of outliers, of which some change little
    assert np.std(ratio[core]) == pytest.approx(0.03, rel=0.15)
    assert np.exp(-2) <= min(factors) < max(factors) <= np.exp(2)


def test_linear_is_exact_on_a_plane_and_its_scale_can_be_lost() -> None:
    view = frame()
    protocol = Protocol(points=200, seed=3)
    (result,) = evaluate_frames([view], load_predictor("linear"), protocol)
    assert result.errors.abs_rel < 0.01
    wrong = lambda rgb, sparse, lens: (3 * load_predictor("linear")(rgb, sparse, lens)[0], None)  # noqa: E731
    (scaled,) = evaluate_frames([view], wrong, protocol)
    assert scaled.errors.abs_rel == pytest.approx(2, abs=0.05)
    (aligned,) = evaluate_frames([view], wrong, protocol.model_copy(update={"alignment": "points"}))
    assert mean_errors([aligned], protocol).abs_rel == pytest.approx(result.errors.abs_rel, abs=2e-3)


def test_a_frame_without_points_is_left_out_and_counted() -> None:
    blind = EvaluationFrame("7", np.zeros((64, 64, 3), np.uint8), np.full((64, 64), 9, np.float32), "mm")
    left_out, protocol = LeftOut(), Protocol(sampler="sfm", points=20)
    results = evaluate_frames([blind, frame()], load_predictor("nearest"), protocol, left_out=left_out)
    assert [result.name for result in results] == [frame().name]
    assert (left_out.without_truth, left_out.without_points) == ([], ["7"])
    assert str(left_out) == "1 without points left out"


@pytest.mark.parametrize("sampler", ["uniform", "sfm"])
def test_a_picture_of_another_size_than_its_depth_is_refused(sampler: str) -> None:
    view = frame()
    halved = EvaluationFrame("7", view.rgb[:40], view.depth, "mm")
    with pytest.raises(CompletionError, match="frame 7: its picture has 64x40 px and its true depth 64x64 px"):
        list(evaluate_frames([halved], load_predictor("linear"), Protocol(sampler=sampler)))


def precision_here() -> str:
    return choose_precision("auto", choose_device("auto"))


def test_the_command_writes_what_it_prints(tmp_path: Path) -> None:
    folder = generate(TINY, tmp_path / "phantom", threads=1)
    assert TINY.events == EventsConfig()
    plots = ("e.png", "sweep.png", "c.png", "compare.png", "attention.png")
    outputs = Outputs(tmp_path / "e.csv", tmp_path / "e.json", *(tmp_path / name for name in plots))
    protocols = [protocol_of("uniform", points, "none", "per_frame", 0, 1) for points in (20, 60)]
    text = evaluate([folder], ["nearest", "mscsa"], protocols, outputs, None, SilentProgress())
    records = json.loads(outputs.json.read_text())
    assert len(records) == 4
    for record in records:
        assert f"{100 * record['mean']['abs_rel']:.4f}" in text
        name = f"e_phantom_{record['model']}_uniform{record['protocol']['points']}"
        rows = list(csv.DictReader((tmp_path / f"{name}.csv").open()))
        assert len(rows) == TINY.motion.frames
        mean = np.mean([float(row["abs_rel"]) for row in rows])
        assert mean == pytest.approx(record["mean"]["abs_rel"], rel=1e-4)
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000
    assert "60 uniform points, no scale alignment, per-frame mean, seed 0" in text
    assert outputs.sweep.exists()
    assert outputs.calibration.exists()
    for points in (20, 60):
        assert (tmp_path / f"compare_phantom_uniform{points}.png").stat().st_size > 10_000
        assert (tmp_path / f"attention_phantom_mscsa_uniform{points}.png").stat().st_size > 10_000
    assert not list(tmp_path.glob("attention_phantom_nearest*"))
    assert [r["calibration"] is not None for r in records] == [r["model"] == "mscsa" for r in records]
    assert {(r["model"], r["precision"]) for r in records} == {("nearest", None), ("mscsa", precision_here())}
    by_points = [r["mean"]["abs_rel"] for r in records if r["model"] == "nearest"]
    assert by_points[1] < by_points[0]
    named = text.rsplit("one for each figure: ", 1)[1].split(", ")
    alone = {*outputs.json.parent.glob("*.json"), outputs.sweep, outputs.calibration}
    assert {Path(name) for name in named} == {p for p in tmp_path.iterdir() if p.is_file()} - alone


def test_a_table_counts_the_points_that_it_is_of_and_the_pixels_that_it_leaves_out(tmp_path: Path) -> None:
    folder = generate(TINY, tmp_path / "phantom", threads=1)
    protocols = [Protocol(points=500, sampler="by_chance", stride=2), Protocol(points=20)]
    text = evaluate([folder], ["nearest"], protocols, Outputs(), None, SilentProgress())
    many, few = text.split("**phantom**: ")[1:]
    assert re.search(r"500 by_chance points \(\d+( to \d+)? found in a frame\), .* one frame in 2", many)
    assert "20 uniform points, no" in few
    assert "one frame in" not in few
    assert "no depth at" not in text
    with Accumulator() as accumulator:
        blind = lambda rgb, sparse, lens: (np.where(np.arange(64) < 16, 0, 9.0).repeat(64).reshape(64, 64).T, None)  # noqa: E731
        accumulator.add_all(evaluate_frames([frame()], blind, Protocol()))
        assert _with_gaps("half", accumulator) == "half (no depth at 25 % of the pixels, in no error)"


def test_points_that_are_given_back_are_no_score(tmp_path: Path) -> None:
    """All true pixels as points: an interpolation would have no error at all."""
    folder = generate(TINY, tmp_path / "phantom", threads=1)
    with pytest.raises(
        CompletionError, match=r"most pixels with true depth are points .* 4000 \(--points\) are too many"
    ):
        evaluate([folder], ["nearest"], [Protocol(points=4000)], Outputs(), None, SilentProgress())


@pytest.mark.parametrize("given", ["..", "depth/..", "."])
def test_a_folder_without_a_name_of_its_own_has_its_real_one(tmp_path: Path, monkeypatch, given: str) -> None:
    folder = generate(TINY, tmp_path / "phantom", threads=1)
    monkeypatch.chdir(folder / "depth" if given == ".." else folder)
    text = evaluate([Path(given)], ["nearest"], [Protocol(points=20)], Outputs(), None, SilentProgress())
    assert "**phantom**: " in text


def test_frames_without_truth_are_not_called_no_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = generate(TINY, tmp_path / "phantom", threads=1)
    for path in (folder / "depth").iterdir():
        cv2.imwrite(str(path), np.zeros((TINY.camera.height, TINY.camera.width), np.uint16))
    ask = partial(evaluate, models=["nearest"], protocols=[Protocol()], outputs=Outputs(), progress=SilentProgress())
    count = TINY.motion.frames
    with pytest.raises(CompletionError, match=f"{count} frames of .*phantom read as rgbd, and none has true depth"):
        ask([folder], kind=None)
    with pytest.raises(CompletionError, match="phantom has no frames, read as c3vd: no picture of that layout"):
        ask([folder], kind="c3vd")
    monkeypatch.chdir(generate(TINY, tmp_path / "other", threads=1))
    assert "**other**: " in ask([Path()], kind=None)


def test_error_and_confidence_are_each_others_inverse() -> None:
    error = np.geomspace(0.003, 0.5, 20).astype(np.float32)
    np.testing.assert_allclose(error_from_confidence(confidence_from_error(error)), error, rtol=1e-3)


@pytest.mark.parametrize("path", ["file/deeper/e.csv", "folder"])
def test_what_cannot_be_written_is_said_before_the_work(tmp_path: Path, path: str) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    with pytest.raises(CompletionError, match=f"cannot write .*{path}"):
        evaluate([tmp_path / "none"], ["linear"], [], Outputs(csv=tmp_path / path), None, SilentProgress())


@pytest.mark.parametrize(
    ("outputs", "sentence"),
    [
        ({"sheet": "s.txt"}, "cannot draw .*s.txt: give a name that ends in .*.png"),
        ({"sweep": "curve"}, "cannot draw .*curve"),
        ({"csv": "new/e.csv", "sweep": "new/curve.txt"}, "cannot draw .*curve.txt"),
        ({"sheet": "s.pgf"}, "cannot draw .*s.pgf"),
        ({"compare": "c.rgba"}, "cannot draw .*c.rgba"),
        ({"csv": "e.csv", "json": "e.csv"}, "two outputs are one file, .*e.csv"),
        ({"csv": "new/e.csv", "json": "new/e.csv"}, "two outputs are one file, .*e.csv"),
        ({"calibration": "c.png"}, "none of these models predicts its own error"),
        ({"attention": "a.png"}, "none of these models has channel attention"),
    ],
)
def test_a_file_that_no_model_can_fill_is_said_before_the_work(
    tmp_path: Path, outputs: dict[str, str], sentence: str
) -> None:
    files = Outputs(**{name: tmp_path / file for name, file in outputs.items()})
    with pytest.raises(CompletionError, match=sentence):
        evaluate([tmp_path / "none"], ["linear"], [Protocol()], files, None, SilentProgress())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_picture_that_is_taken_can_be_drawn(tmp_path: Path, kind: str) -> None:
    assert sweep_plot(tmp_path / f"s.{kind}", {"nearest": {20: 0.1, 60: 0.05}}, "").stat().st_size > 1000


def test_progress_counts_the_frames_that_are_judged() -> None:
    seen: list[int] = []
    frames = [frame() for _ in range(7)]
    list(evaluate_frames(frames, load_predictor("nearest"), Protocol(stride=3), seen.append))
    assert seen == [1, 2, 3]


def test_slips_are_one_sentence() -> None:
    for values in (("poisson", "none", "per_frame"), ("uniform", "gt", "per_frame"), ("uniform", "none", "mean")):
        with pytest.raises(CompletionError, match="known:"):
            protocol_of(values[0], 10, values[1], values[2], 0, 1)
    with pytest.raises(CompletionError, match=r"no model .* mscsa, nearest, linear"):
        load_predictor("monodepth")


def test_a_protocol_says_how_sfm_points_are_scaled() -> None:
    assert "100 sfm points, their unknown scale given back by its true value" in str(Protocol(sampler="sfm"))
    assert "scale from the sparse points" in str(Protocol(sampler="sfm", alignment="points"))
