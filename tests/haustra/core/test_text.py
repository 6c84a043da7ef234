"""Text and JSON in the encodings that editors save, whole, cut and of another type."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from haustra.core.camera import read_camera
from haustra.core.errors import HaustraError
from haustra.core.text import counted, json_text, read_json, read_text
from reconstruction.evaluation.trajectory_io import read_tum

ENCODINGS = ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"]
CAMERA = {"model": "PINHOLE", "width": 64, "height": 48, "params": [50, 50, 32, 24], "note": "Länge µm"}
TUM = "# Zeit, mm\n0.0 1 2 3 0 0 0 1\n0.1 1 2 3 0 0 0 1\n"


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_encoding_reads_the_same(tmp_path: Path, encoding: str) -> None:
    camera, path = tmp_path / "camera.json", tmp_path / "truth.txt"
    camera.write_text(json.dumps(CAMERA, ensure_ascii=False), encoding=encoding)
    path.write_text(TUM, encoding=encoding)
    assert read_json(camera) == CAMERA
    assert read_camera(camera).width == 64
    assert read_tum(path)[0].tolist() == [0.0, 0.1]


@pytest.mark.parametrize(
    "data", [b"\xff\x00\x12garbage\x81", b"\xc3\x28", b"0 1 2 3 0 0 0 1\n\0\0\0", "0 1 2 3 0 0 0 1".encode("utf-32-be")]
)
def test_what_is_no_text_is_one_sentence(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "truth.txt"
    path.write_bytes(data)
    with pytest.raises(HaustraError, match=r"truth.txt"):
        read_tum(path)


@pytest.mark.parametrize("cut", [0, 1, 10, 40])
def test_a_camera_file_that_is_cut_is_one_sentence(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(CAMERA)[:cut])
    with pytest.raises(HaustraError, match="not whole JSON"):
        read_camera(path)


@pytest.mark.parametrize("text", ["[]", '"camera"', "3", "null", "[" * 100_000, '{"width": ' + "9" * 5000 + "}"])
def test_json_of_another_type_is_one_sentence(tmp_path: Path, text: str) -> None:
    path = tmp_path / "camera.json"
    path.write_text(text)
    with pytest.raises(HaustraError, match=r"camera.json"):
        read_json(path)


def test_a_missing_file_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(HaustraError, match="No such file"):
        read_text(tmp_path / "none.txt")


@pytest.mark.parametrize(("number", "told"), [(0, "0 submaps"), (1, "1 submap"), (2, "2 submaps")])
def test_one_is_singular(number: int, told: str) -> None:
    assert counted(number, "submap") == told


def test_json_has_no_nan_and_no_infinity():
    value = {"a": [1.5, float("nan"), (2, float("inf"))], "b": {"c": -float("inf"), "d": "NaN"}}
    read = json.loads(json_text(value), parse_constant=pytest.fail)
    assert read == {"a": [1.5, None, [2, None]], "b": {"c": None, "d": "NaN"}}
