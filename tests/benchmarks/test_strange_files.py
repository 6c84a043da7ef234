"""Each way of storing a film strangely, several seeds: what is read is the film, frame by frame, at its times."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.robustness.strange_files import STRANGE, write_camera
from pipeline.input.calibration import calibrate
from pipeline.input.video import Source
from tests.helpers.videos import textured_frames

SIDE, COUNT, EVERYDAY, ALL = 96, 60, 2, 12
CAMERA = {"model": "PINHOLE", "width": SIDE, "height": SIDE, "params": [60.0, 60.0, 48.0, 48.0]}
SEEDS = [pytest.param(seed, marks=[pytest.mark.slow] if seed >= EVERYDAY else []) for seed in range(ALL)]


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("kind", STRANGE)
def test_what_is_read_is_the_film(tmp_path: Path, kind: str, seed: int) -> None:
    frames = textured_frames(COUNT, SIDE, seed, step=3)
    strange = STRANGE[kind](frames, np.random.default_rng(seed), tmp_path)
    shown = list(Source(strange.source))
    assert len(shown) == len(strange.rows)
    np.testing.assert_allclose([frame.seconds for frame in shown], strange.seconds, atol=0.012)
    for frame, row in zip(shown, strange.rows, strict=True):
        truth = frames[row]
        assert frame.rgb.shape == truth.shape
        if kind == "interlaced":  # the rows between are made from those of the field
            assert np.abs(frame.rgb[::2].astype(int) - truth[::2]).mean() < 8
        else:
            blurred = cv2.blur(frame.rgb, (3, 3)).astype(int) - cv2.blur(truth, (3, 3))
            assert np.abs(blurred).mean() < 8
    write_camera(tmp_path / "lens.json", CAMERA, strange)
    found = calibrate(str(tmp_path / "lens.json"), tmp_path, (SIDE, SIDE), (0, 0, SIDE, SIDE)).camera
    np.testing.assert_allclose(found.params, CAMERA["params"])
    assert json.dumps(found.to_dict())
