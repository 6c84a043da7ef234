"""A mistyped name is answered before anything heavy is loaded, and names what was not found."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from haustra.core.errors import HaustraError
from pipeline.cli.given_paths import STREAMS, must_be_named_or_exist, must_exist
from pipeline.cli.main import app, run_cleanly
from pipeline.live.capture.live_film import SCHEMES

COMMANDS = [
    ["reconstruct", "no.mp4"],
    ["reconstruct", "film.mp4", "--camera", "no.json"],
    ["reconstruct", "film.mp4", "--model", "no.safetensors"],
    ["reconstruct", "film.mp4", "--scale", "no.yaml"],
    ["reconstruct", "film.mp4", "--poses", "no.txt"],
    ["reconstruct", "film.mp4", "--stereo", "no.yaml"],
    ["reconstruct", "film.mp4", "--depth-folder", "no"],
    ["reconstruct", "film.mp4", "--config", "no.yaml"],
    ["reconstruct", "--demo", "--camera", "no.json"],
    ["batch", "film.mp4", "-o", "out", "--config", "no.yaml"],
    ["batch", "no*.avi", "-o", "out"],
    ["compare", "no", "film.mp4"],
    ["compare", "run", "no"],
    ["export", "no", "colon.obj"],
    ["export", "run", "no/colon.obj"],
    ["compare", "run", "film.mp4", "--json", "no/figures.json"],
    ["evaluate", "film.mp4", "no"],
    ["train", "no", "--out", "weights.safetensors"],
    ["onnx", "no/model.onnx"],
    ["view", "no"],
]
INTO_A_FOLDER = [["onnx", "run"], ["train", "run", "--out", "run"], ["compare", "run", "run", "--json", "run"]]
SCRIPT = """
import contextlib, io, json, sys
from pipeline.cli.main import app, run_cleanly
told = []
for words in json.load(sys.stdin):
    sys.argv = ["haustra", *words]
    error = io.StringIO()
    with contextlib.redirect_stderr(error):
        code = run_cleanly(app)
    told.append([code, error.getvalue(), sorted({"torch", "cv2", "numpy", "av"} & set(sys.modules))])
print(json.dumps(told))
"""


def test_every_command_names_what_is_not_there_at_once(tmp_path: Path) -> None:
    (tmp_path / "film.mp4").write_bytes(b"not looked at")
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.yaml").write_text("{}")
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], input=json.dumps(COMMANDS), capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    for words, (code, error, heavy) in zip(COMMANDS, json.loads(done.stdout), strict=True):
        wrong = next(word for word in words if word.startswith("no") and word[2:3] in ("", ".", "/", "*"))
        wrong = wrong.split("/")[0]
        assert code == 1, words
        assert len(error.splitlines()) == 1, words
        assert f"{wrong}\n" in error or f"{wrong} " in error, words
        assert not heavy, words
    assert sorted(path.name for path in tmp_path.iterdir()) == ["film.mp4", "run"]


@pytest.mark.parametrize("words", INTO_A_FOLDER)
def test_a_folder_where_a_file_is_to_be_written_is_said_before_the_work(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.yaml").write_text("{}")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["haustra", *words])
    assert run_cleanly(app) == 1
    assert capsys.readouterr().err == "error: run is a folder; give the name of a file to write\n"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run"]


def test_the_streams_are_those_that_live_takes() -> None:
    assert STREAMS == SCHEMES


@pytest.mark.parametrize("address", ["http://host/film.mp4", "rtsp://10.0.0.5/scope"])
def test_the_address_of_a_stream_is_sent_to_the_command_that_takes_it(address: str) -> None:
    with pytest.raises(HaustraError, match=r"there is no file .*; a stream is taken by haustra live"):
        must_exist(Path(address))


@pytest.mark.parametrize("choice", [None, "auto", "colonoscope", "endomapper-03", __file__])
def test_names_and_files_pass(choice: str | None) -> None:
    must_be_named_or_exist("--camera", choice)


@pytest.mark.parametrize("choice", ["lens.json", "folder/lens", "./lens"])
def test_a_file_that_is_not_there_does_not(choice: str) -> None:
    with pytest.raises(HaustraError, match="--camera: there is no file"):
        must_be_named_or_exist("--camera", choice)
