"""The reader of camera files of docs/extending.md, known by its row to `--camera`."""

import pytest

from haustra.core.errors import HaustraError
from pipeline.input.calibration import calibrate, check_choice
from pipeline.input.camera_files.registry import CAMERA_FORMATS
from tests.helpers.recipes import add_row, written


def test_the_command_reads_it(tmp_path, monkeypatch):
    path = tmp_path / "scope.txt"
    path.write_text("focal 410 centre 322.5 238.25\n")
    with pytest.raises(HaustraError, match="no camera file that is known"):
        check_choice(str(path), tmp_path)
    written("pipeline/input/camera_files/three_numbers.py", monkeypatch)
    assert add_row(CAMERA_FORMATS, "pipeline/input/camera_files/registry.py", monkeypatch) == "three numbers"
    check_choice(str(path), tmp_path)
    calibration = calibrate(str(path), tmp_path, (640, 480), (0, 0, 640, 480))
    assert calibration.camera.params == (410, 410, 323.0, 238.75)
    assert "three numbers" in calibration.origin
    path.write_text("focal 410\n")
    with pytest.raises(HaustraError, match="another form than this format's"):
        check_choice(str(path), tmp_path)
