"""The script on the page of calibration, run on a film of a checkerboard under a lens that is known."""

import json
import re
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.robustness.strange_files import encode

PAGE = Path(__file__).parents[2] / "docs/guide/calibrate.md"
SIZE, FOCAL, CENTRE, K1 = 320, 150.0, (164.0, 157.0), 0.03  # centre from the first pixel's corner
SQUARES = 10, 7


def board_under_the_lens(turn: Rotation, place: np.ndarray) -> np.ndarray:
    """Picture (SIZE,SIZE,3): each pixel's ray, by the lens's own inverse, met with the plane of the board."""
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5
    u, v = (x - CENTRE[0]) / FOCAL, (y - CENTRE[1]) / FOCAL
    bent = np.hypot(u, v)
    angle = bent.copy()
    for _ in range(20):
        angle = bent / (1 + K1 * angle**2)
    ray = np.stack([u, v, bent / np.tan(np.maximum(angle, 1e-9))], axis=-1)
    normal = turn.as_matrix()[:, 2]
    hit = ray * ((normal @ place) / (ray @ normal))[..., None]
    across, down, _ = np.moveaxis((hit - place) @ turn.as_matrix(), -1, 0)
    inside = (across > -1) & (down > -1) & (across < SQUARES[0] - 1) & (down < SQUARES[1] - 1)
    dark = (np.floor(across) + np.floor(down)) % 2 == 0
    grey = np.where(inside & dark, 20, 220).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng, path = np.random.default_rng(0), tmp_path_factory.mktemp("board") / "board.mp4"
    frames = []
    for _ in range(16):
        turn = Rotation.from_euler("xyz", rng.uniform(-35, 35, 3), degrees=True)
        middle = np.array([*rng.uniform(-2, 2, 2), rng.uniform(4.5, 8)])
        large = cv2.GaussianBlur(board_under_the_lens(turn, middle - turn.apply([4, 2.5, 0])), (0, 0), 0.7)
        frames.append(large)
    encode(path, frames)
    return path


def test_the_script_finds_the_lens_and_the_run_takes_its_file(film: Path, tmp_path: Path) -> None:
    (script,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    (tmp_path / "calibrate.py").write_text(script)
    command = [sys.executable, "calibrate.py", str(film), str(SQUARES[0] - 1), str(SQUARES[1] - 1), "1"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert "views, 0." in done.stdout
    found = json.loads((tmp_path / "camera.json").read_text())
    assert found["model"] == "OPENCV_FISHEYE"
    np.testing.assert_allclose(found["params"][:2], FOCAL, rtol=0.01)
    np.testing.assert_allclose(found["params"][2:4], CENTRE, atol=1.0)
