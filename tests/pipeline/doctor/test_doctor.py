"""Findings of machines that lack something, and a run told without anything that could name a patient."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
import yaml

from haustra.core.errors import HaustraError
from pipeline.cli import doctor as command
from pipeline.doctor import machine, report, self_test
from pipeline.doctor.machine import Finding

FLAGS = ["sse2", *machine.FEATURES]


@pytest.mark.parametrize("without", machine.FEATURES)
def test_what_a_processor_lacks_is_told_with_what_it_means(without: str) -> None:
    text = f"model name\t: Made Up 9\nflags\t\t: {' '.join(flag for flag in FLAGS if flag != without)}\n"
    found = {finding.subject: finding for finding in machine.processor(text)}
    assert "Made Up 9" in found["processor"].value
    for name, meaning in machine.FEATURES.items():
        assert found[name].value == ("no" if name == without else "yes")
        assert (found[name].meaning == meaning) == (name == without)
    assert found["avx2"].verdict == ("fault" if without == "avx2" else "ok")


@pytest.mark.parametrize("text", ["", "CPU part : 0xd0c\nFeatures : fp asimd\n"])
def test_another_kind_of_processor_is_no_fault(text: str) -> None:
    assert all(finding.verdict != "fault" for finding in machine.processor(text))


def test_a_library_that_cannot_be_imported_names_its_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(machine.IMPORTS, "numpy", "raise ImportError('libGL.so.1: cannot open shared object file')")
    found = machine._library("numpy", "numpy")
    assert found.verdict == "fault"
    assert "libGL.so.1" in found.meaning
    assert machine._library("nothing", "no-such-distribution").value == "not installed"


def test_faults_leave_the_self_test_out_and_end_with_code_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(machine, "libraries", lambda: [Finding("torch", "not installed", "fault", "pip install torch")])
    with pytest.raises(HaustraError, match="1 findings"):
        command.doctor(None, True)
    told = capsys.readouterr().out
    assert "! torch" in told
    assert "left out" in told


def test_a_failing_self_test_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise ZeroDivisionError("of the test")

    monkeypatch.setattr(self_test, "_figures", fail)
    (finding,) = self_test.self_test()
    assert finding.verdict == "fault"
    assert "ZeroDivisionError: of the test" in finding.meaning


@pytest.mark.parametrize(("figures", "faults"), [((21, 0.02, 89), 0), ((20, 0.02, 89), 1), ((21, 3.0, 20), 2)])
def test_figures_are_held_against_what_is_expected(
    monkeypatch: pytest.MonkeyPatch, figures: tuple[int, float, float], faults: int
) -> None:
    monkeypatch.setattr(self_test, "_figures", lambda: figures)
    assert sum(finding.verdict == "fault" for finding in self_test.self_test()) == faults


NAMES = ["Mueller 1950-01-02.mp4", "Mueller.mp4", "a b.avi", "MÜLLER_Anna.dcm", "x:y.mkv"]
FOLDERS = ["/home/mueller/films", "C:\\Users\\Mueller", "/mnt/Anna Mueller"]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("folder", FOLDERS)
def test_nothing_that_is_told_names_a_file_or_folder(tmp_path: Path, name: str, folder: str) -> None:
    run = tmp_path / (Path(name).stem + "_run")
    run.mkdir()
    record = {
        "versions": {"haustra": "0.2.0"},
        "config": {"camera": f"{folder}/lens.json", "seed": 3, "poses": {"file": "mueller.txt"}},
        "source": {"path": f"{folder}/{name}"},
        "stages": {"frames": {"camera_origin": "file lens.json", "notes": [f"{name} is interlaced"]}},
        "refused": f"cannot read {folder}/{name}",
    }
    (run / "run.yaml").write_text(yaml.safe_dump(record))
    (run / "metrics.json").write_text(json.dumps({"frames": {"posed": 3}, "warnings": [f"see {run}"]}))
    told = report.facts_of_run(run)
    for secret in ("ueller", "ÜLLER", "lens.json", Path(name).stem):
        assert secret not in told
    assert yaml.safe_load(told)["config"]["seed"] == 3
    assert yaml.safe_load(told)["metrics"]["frames"] == {"posed": 3}


@pytest.mark.parametrize("text", ["", "[1, 2]", "{", "a: [b"])
def test_a_damaged_record_is_one_sentence(tmp_path: Path, text: str) -> None:
    (tmp_path / "run.yaml").write_text(text)
    with pytest.raises(HaustraError, match="damaged"):
        report.facts_of_run(tmp_path)


@pytest.mark.slow
def test_this_installation_passes_its_own_test() -> None:
    found = report.examine(Path.cwd())
    assert not [str(finding) for finding in found if finding.verdict == "fault"]
    assert sys.version.split()[0] in {finding.value for finding in found}
