"""What is left of an evaluation that an error, Ctrl-C or a full disk ended."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from completion.evaluation.accumulator import Accumulator
from completion.evaluation.evaluate import Protocol, evaluate_frames
from completion.evaluation.outputs import Outputs
from completion.evaluation.run import evaluate, evaluated_tables
from haustra.core.errors import CompletionError
from haustra.core.progress import SilentProgress
from haustra.phantom.dataset.generate import generate
from tests.helpers.tiny_phantom import TINY


def test_what_was_judged_before_an_error_is_kept(tmp_path: Path) -> None:
    good, bad = (generate(TINY, tmp_path / name, threads=1) for name in ("good", "bad"))
    sorted((bad / "depth").iterdir())[2].write_bytes(b"cut off")
    outputs = Outputs(csv=tmp_path / "e.csv", json=tmp_path / "e.json")
    tables = evaluated_tables([good, bad], ["nearest"], [Protocol(points=20)], outputs, None, SilentProgress())
    assert "**good**" in next(tables)
    with pytest.raises(CompletionError, match=r"cannot read .*; 2 frames judged before it: .*e_bad_nearest_uniform20"):
        next(tables)
    assert [record["folder"] for record in json.loads(outputs.json.read_text())] == ["good"]
    assert len(list(csv.DictReader((tmp_path / "e_bad_nearest_uniform20.csv").open()))) == 2


@pytest.mark.parametrize("writable", [True, False])
@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError(28, "No space left on device"), MemoryError()])
def test_any_end_keeps_the_frames_judged_before_it(tmp_path: Path, monkeypatch, error, writable: bool) -> None:
    def cut(*given):
        for number, result in enumerate(evaluate_frames(*given)):
            if number == 2:
                raise error
            yield result

    folder, path = generate(TINY, tmp_path / "phantom", threads=1), tmp_path / "e.csv"
    monkeypatch.setattr("completion.evaluation.run.evaluate_frames", cut)
    if not writable:
        path.symlink_to("/dev/full")
    with pytest.raises(type(error)) as ended:
        evaluate([folder], ["nearest"], [Protocol(points=20)], Outputs(csv=path), None, SilentProgress())
    assert ended.value is error
    if writable:
        assert len(list(csv.DictReader(path.open()))) == 2


def test_an_error_is_told_although_the_csv_cannot_be_written(tmp_path: Path) -> None:
    folder = generate(TINY, tmp_path / "phantom", threads=1)
    sorted((folder / "depth").iterdir())[2].write_bytes(b"cut off")
    (tmp_path / "e.csv").symlink_to("/dev/full")
    outputs = Outputs(csv=tmp_path / "e.csv")
    with pytest.raises(CompletionError, match=r"cannot read .*; 2 frames judged before it, which .*e.csv could not"):
        evaluate([folder], ["nearest"], [Protocol(points=20)], outputs, None, SilentProgress())


def test_a_full_disk_leaves_the_finished_models_in_the_json_and_the_frames_in_the_csv(tmp_path, monkeypatch) -> None:
    folder = generate(TINY, tmp_path / "phantom", threads=1)
    outputs = Outputs(csv=tmp_path / "e.csv", json=tmp_path / "e.json")
    protocols, write = [Protocol(points=20), Protocol(points=60)], Path.write_text

    def half(path: Path, text: str) -> int:
        write(path, text[: len(text) // 2])
        raise OSError(28, "No space left on device")

    tables = evaluated_tables([folder], ["nearest"], protocols, outputs, None, SilentProgress())
    next(tables)
    monkeypatch.setattr(Path, "write_text", half)
    with pytest.raises(OSError, match="No space"):
        next(tables)
    assert [record["protocol"]["points"] for record in json.loads(outputs.json.read_text())] == [20]
    assert len(list(csv.DictReader((tmp_path / "e_phantom_nearest_uniform60.csv").open()))) == TINY.motion.frames
    assert not list(tmp_path.glob("*.partial"))


def test_json_goes_through_a_link_and_into_a_device(tmp_path: Path) -> None:
    folder, link, device = generate(TINY, tmp_path / "phantom", threads=1), tmp_path / "e.json", Path("/dev/null")
    link.symlink_to(tmp_path / "far.json")
    for path in (link, device):
        evaluate([folder], ["nearest"], [Protocol(points=20)], Outputs(json=path), None, SilentProgress())
    assert json.loads((tmp_path / "far.json").read_text())
    assert link.is_symlink()
    assert device.is_char_device()


def test_the_files_are_named_although_there_is_nothing_to_calibrate(tmp_path: Path, monkeypatch) -> None:
    folder = generate(TINY, tmp_path / "phantom", threads=1)
    monkeypatch.setattr(Accumulator, "calibration", lambda accumulator: None)
    outputs = Outputs(csv=tmp_path / "e.csv", calibration=tmp_path / "c.png")
    protocols = [Protocol(points=20), Protocol(points=60)]
    tables = evaluated_tables([folder], ["mscsa"], protocols, outputs, None, SilentProgress())
    next(tables), next(tables)
    assert "one for each figure: " in next(tables)
    with pytest.raises(CompletionError, match="too few pixels"):
        next(tables)
