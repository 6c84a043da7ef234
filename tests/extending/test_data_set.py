"""The reader of docs/extending.md, used by `haustra evaluate`."""

import json
import sys

import numpy as np
import pytest

from completion.data.readers import READERS, Reader, read_evaluation_frames, recognise
from haustra.core.errors import CompletionError
from pipeline.cli import main as cli
from tests.helpers.recipes import add_row, written

SIDE = 32


@pytest.fixture
def folder(tmp_path):
    """Two frames; depth is 20 mm in the left half and 40 mm in the right one, and unknown in the first row."""
    folder = tmp_path / "sigmoid"
    folder.mkdir()
    depth = np.full((SIDE, SIDE), 0.02)
    depth[:, SIDE // 2 :], depth[0] = 0.04, 0
    for number in range(2):
        np.savez(folder / f"frame_{number:04d}.npz", rgb=np.full((SIDE, SIDE, 3), 90, np.uint8), depth_m=depth)
    return folder


def evaluate(monkeypatch, *words):
    monkeypatch.setattr(sys, "argv", ["haustra", "evaluate", *map(str, words), "-q"])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    return stop.value.code or 0


def test_the_command_reads_it(folder, tmp_path, monkeypatch, capsys):
    with pytest.raises(CompletionError, match="is no data set that can be read"):
        recognise(folder)
    written("completion/data/numpy_folder.py", monkeypatch)
    assert add_row(READERS, "completion/data/readers.py", monkeypatch, {"Reader": Reader}) == "numpy"
    assert recognise(folder) == "numpy"
    first, second = read_evaluation_frames(folder)
    assert (first.name, second.name, first.unit, first.group) == ("frame_0000", "frame_0001", "mm", "sigmoid")
    assert set(np.unique(first.depth)) == {np.float32(0), np.float32(20), np.float32(40)}

    record = tmp_path / "errors.json"
    assert evaluate(monkeypatch, folder, "--model", "nearest", "--points", 400, "--json", record) == 0
    assert "2 frames" in capsys.readouterr().out
    (told,) = json.loads(record.read_text())
    assert told["unit"] == "mm"
    # The nearest point is wrong at the edge alone, and there by 20 mm: the RMSE is 20 times the root of that share.
    share = told["mean"]["mae"] / 20
    assert 0 < share < 0.1
    assert told["mean"]["rmse"] == pytest.approx(20 * np.sqrt(share), rel=0.05)
    assert evaluate(monkeypatch, folder, "--model", "nearest", "--dataset", "numpy") == 0


def test_a_folder_that_no_row_fits_is_told_its_pattern(folder, tmp_path, monkeypatch, capsys):
    written("completion/data/numpy_folder.py", monkeypatch)
    add_row(READERS, "completion/data/readers.py", monkeypatch, {"Reader": Reader})
    (tmp_path / "empty").mkdir()
    assert evaluate(monkeypatch, tmp_path / "empty") == 1
    assert "numpy (frame_*.npz)" in capsys.readouterr().err
    assert evaluate(monkeypatch, folder, "--dataset", "numyp") == 1
    assert "rgbd, numpy" in capsys.readouterr().err
