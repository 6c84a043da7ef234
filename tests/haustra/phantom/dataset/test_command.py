"""`haustra phantom`: folders made, kept, refused and replaced; the suite; sentences instead of tracebacks."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

import pipeline.cli.phantom as command
from haustra.core.errors import HaustraError, PhantomError
from haustra.core.progress import SilentProgress
from haustra.phantom.config import PhantomConfig
from haustra.phantom.dataset.checks import CHOICES, FREE_TEXT, RANGES, check
from haustra.phantom.dataset.generate import generate, is_finished
from haustra.phantom.dataset.randomise import randomised
from haustra.phantom.dataset.scenes import SCENES, scene_config
from haustra.phantom.dataset.shards import ShardPlan
from haustra.phantom.dataset.suite import SUITE_FILE, load_suite
from haustra.phantom.timeline import EVENTS, plan_timeline
from pipeline.cli.main import app
from pipeline.cli.phantom import PhantomOptions, chosen_config, render, render_training, suite_folders
from tests.helpers.tiny_phantom import TINY

QUIET = SilentProgress()


def test_a_film_is_made_once_kept_and_replaced_when_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    films: list[Path] = []

    def counted(config: PhantomConfig, folder: Path, **rest: object) -> Path:
        films.append(folder)
        return generate(config, folder, **rest)

    monkeypatch.setattr(command, "generate", counted)
    folder = tmp_path / "a"
    for _ in range(2):
        assert render({folder: TINY}, QUIET) == [folder]
    assert len(films) == 1
    (folder / "mesh.ply").unlink()  # stopped half-way: begun anew
    render({folder: TINY}, QUIET)
    assert len(films) == 2
    shorter = replace(TINY, motion=replace(TINY.motion, frames=2))
    with pytest.raises(HaustraError, match="--overwrite"):
        render({folder: shorter}, QUIET)
    render({folder: shorter}, QUIET, overwrite=True)
    assert sorted(path.name for path in (folder / "rgb").iterdir()) == ["00000.png", "00001.png"]
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(HaustraError, match=r"something else \(notes\.txt\)"):
        render({folder: TINY}, QUIET, overwrite=True)
    assert (folder / "notes.txt").read_text() == "mine"


def test_a_stranger_in_the_suite_stops_it_before_any_work(tmp_path: Path) -> None:
    (tmp_path / "events").mkdir()
    (tmp_path / "events" / "thesis.tex").write_text("precious")
    with pytest.raises(HaustraError, match="something else"):
        render(suite_folders(tmp_path, SUITE_FILE), QUIET)
    assert not (tmp_path / "easy_withdrawal").exists()


def test_the_suite_has_five_different_sequences() -> None:
    suite = load_suite()
    assert list(suite) == ["easy_withdrawal", "flexure", "loop", "low_texture", "events"]
    assert len({config.seed for config in suite.values()}) == 5
    assert suite["loop"].motion.direction == "loop"
    assert suite["low_texture"].appearance.tree_vessels == 0
    events = suite["events"].events
    assert (events.red_outs, events.water_jets, events.bubbles, events.tools, events.peristalsis) == (1,) * 5


def test_options_go_on_top_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(yaml.safe_dump({"scene": "csd", "seed": 4, "imaging": {"gamma": 2}}))
    config = chosen_config(PhantomOptions(config=file, seed=8, frames=40, size=64, motion="loop"))
    assert config.seed == 8
    assert config.imaging.gamma == 2.0
    assert (config.camera.width, config.camera.height) == (64, 64)
    assert (config.motion.frames, config.motion.direction) == (40, "loop")
    assert chosen_config(PhantomOptions(events=True)).events.tools == 1


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ("scene: stomach", "unknown scene"),
        ("camera: {fov_deg: wide}", "expected float"),
        ("camera: {width: 321}", "even width"),
        ("motion: {frames: 0}", "motion.frames: 0 is not within"),
        ("imaging: {gamma: .nan}", "finite"),
        ("anatomy: {polyps: -1}", "anatomy.polyps: -1 is not within"),
        ("imaging: {border: hexagon}", "imaging.border: unknown 'hexagon'"),
        ("imaging: {blur_px: -1}", "imaging.blur_px"),
        ("anatomy: {scene: stomach}", "anatomy.scene: unknown"),
        ("appearance: {tissue: [0.2, 5, 0.1]}", "appearance.tissue: 5 is not"),
        ("camera: {model: OPENCV_FISHEYE, fov_deg: 150, distortion: [-0.1, 0, 0, 0]}", "folds over"),
        ("camera: {model: OPENCV, fov_deg: 110, distortion: [-0.6, 0, 0, 0]}", "folds over"),
        ("camera: {distortion: [0.1, 0, 0, 0]}", "PINHOLE has no distortion"),
        ("scene: [a]", "unknown scene"),
        ("motion: {direction: sideways}", "motion.direction: unknown"),
        ("", "is empty"),
        ("appearance: {tissue: [1, 2]}", "expected 3 numbers"),
        ("seed: -4", "whole number"),
        ("- a list", "expected a mapping"),
        ("a: [", "not a YAML file"),
    ],
)
def test_bad_settings_are_one_sentence_and_leave_nothing(tmp_path: Path, values: str, sentence: str) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text(values)
    with pytest.raises(PhantomError, match=sentence) as caught:
        render({tmp_path / "out": chosen_config(PhantomOptions(config=file))}, QUIET)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out" / "rgb").exists()


def test_every_setting_has_a_range_or_its_choices() -> None:
    config = PhantomConfig()
    for section in ("anatomy", "appearance", "imaging", "camera", "motion", "events", "tissue"):
        for field in fields(getattr(config, section)):
            value, name = getattr(getattr(config, section), field.name), f"{section}.{field.name}"
            known = (*CHOICES, *FREE_TEXT) if isinstance(value, str) else RANGES
            assert isinstance(value, bool) or name in known, name
    for scene in SCENES:
        check(scene_config(scene))
    for seed in range(20):
        check(randomised(np.random.default_rng(seed)))


@pytest.mark.parametrize(
    "options",
    [PhantomOptions(motion="loop", events=True), PhantomOptions(events=True), PhantomOptions(scene="csd", seed=3)],
)
def test_documented_films_have_room_for_what_happens_in_them(options: PhantomOptions) -> None:
    config = chosen_config(options)
    check(config)
    kinds = {slot.kind for slot in plan_timeline(config.motion, config.events, config.seed)}
    assert kinds == (set(EVENTS) if options.events else set())


def test_a_file_that_was_cut_off_is_not_a_finished_film(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full_disk(*arguments: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("haustra.phantom.dataset.generate.os.replace", full_disk)
        with pytest.raises(OSError, match="No space"):
            generate(TINY, tmp_path, threads=1)
    assert not is_finished(tmp_path, TINY)
    generate(TINY, tmp_path, threads=1)
    assert is_finished(tmp_path, TINY)


def test_the_file_keeps_its_own_way_when_the_film_gets_longer(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(yaml.safe_dump({"motion": {"start": 0.4, "speed_mm": 0.2}, "anatomy": {"length_mm": 250.0}}))
    config = chosen_config(PhantomOptions(config=file, frames=100))
    assert (config.motion.start, config.motion.speed_mm, config.anatomy.length_mm) == (0.4, 0.2, 250.0)


def test_training_frames_have_their_contract_and_are_not_replaced(tmp_path: Path) -> None:
    render_training(tmp_path / "t", 3, PhantomOptions(size=32, seed=1), 1, QUIET)
    assert np.load(tmp_path / "t" / "images.npy", mmap_mode="r").shape == (3, 32, 32, 3)
    assert set(ShardPlan(tmp_path, 3, 32, 1).arrays()) == {p.stem for p in (tmp_path / "t").glob("*.npy")}
    with pytest.raises(HaustraError, match="already holds"):
        render_training(tmp_path / "t", 3, PhantomOptions(), 1, QUIET)
    with pytest.raises(HaustraError, match="drawn"):
        render_training(tmp_path / "u", 3, PhantomOptions(frames=4), 1, QUIET)


def test_the_command_fails_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    line = [sys.executable, "-m", "pipeline", "phantom", str(tmp_path / "file"), "--frames", "3"]
    code = "import sys; from pipeline.cli.main import main; sys.argv[0] = 'haustra'; main()"
    done = subprocess.run([line[0], "-c", code, *line[3:]], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr.strip() == f"error: {tmp_path / 'file'} is a file; give a folder"


def test_contradicting_options_are_refused(tmp_path: Path) -> None:
    for options in (["--suite", "--gallery"], ["--suite", "--seed", "3"]):
        result = CliRunner().invoke(app, ["phantom", str(tmp_path / "o"), *options])
        assert isinstance(result.exception, HaustraError)
