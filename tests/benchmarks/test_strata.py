"""Strata of several films are pooled pixel by pixel; rectified films show what a pinhole camera sees."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.completion.strata import pooled, rectified_film


def film(pixels: int, within: float, error: float, kept: float, close: float | None) -> dict:
    return {"pixels": pixels, "within_one": within, "abs_rel": error, "kept": kept, "kept_close": close}


def test_every_pixel_counts_the_same_and_closeness_is_of_kept_pixels() -> None:
    found = pooled([film(100, 0.5, 0.1, 0.2, 1.0), film(300, 0.9, 0.3, 0.6, 0.5)])
    assert found["pixels"] == 400
    assert found["within_one"] == pytest.approx(0.8)
    assert found["abs_rel"] == pytest.approx(0.25)
    assert found["kept"] == pytest.approx(0.5)
    assert found["kept_close"] == pytest.approx((20 * 1.0 + 180 * 0.5) / 200)


def test_a_film_that_keeps_nothing_takes_nothing_away() -> None:
    found = pooled([film(100, 0.5, 0.1, 0.0, None), film(100, 0.5, 0.1, 0.5, 0.8)])
    assert found["kept_close"] == pytest.approx(0.8)
    assert pooled([film(10, 0.5, 0.1, 0.0, None)])["kept_close"] is None


def fisheye_film(folder: Path) -> Path:
    """Five frames of an equidistant fisheye whose depth is 10 mm + 1 mm for each 10 degrees off its axis."""
    focal, width, height = 60.0, 160, 120
    columns, rows = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    depth = 10 + np.degrees(np.hypot(columns, rows) / focal) / 10
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
    for frame in range(5):
        cv2.imwrite(str(folder / "rgb" / f"{frame:05d}.png"), np.full((height, width, 3), 40 * frame, np.uint8))
        cv2.imwrite(str(folder / "depth" / f"{frame:05d}.png"), np.round(100 * depth).astype(np.uint16))
    lens = {"model": "OPENCV_FISHEYE", "width": width, "height": height, "depth_unit_mm": 0.01}
    centred = [focal, focal, width / 2, height / 2, 0.0, 0.0, 0.0, 0.0]
    (folder / "camera.json").write_text(json.dumps(lens | {"params": centred}))
    return folder


def test_a_rectified_film_has_the_depth_that_the_pinholes_pixels_see(tmp_path: Path) -> None:
    made = rectified_film(fisheye_film(tmp_path / "film"), tmp_path / "made", 2)
    about = json.loads((made / "camera.json").read_text())
    assert about["model"] == "PINHOLE"
    fx, fy, cx, cy = about["params"]
    names = sorted(path.name for path in (made / "depth").iterdir())
    assert names == ["00000.png", "00002.png", "00004.png"]
    depth = cv2.imread(str(made / "depth" / names[0]), cv2.IMREAD_UNCHANGED) / 100
    columns, rows = np.meshgrid(np.arange(160) + 0.5, np.arange(120) + 0.5)
    angle = np.degrees(np.arctan(np.hypot((columns - cx) / fx, (rows - cy) / fy)))
    inside = depth > 0
    assert inside.mean() > 0.9
    one_pixel = np.degrees(1 / 60.0) / 10
    assert np.abs(depth - (10 + angle / 10))[inside].max() < one_pixel
