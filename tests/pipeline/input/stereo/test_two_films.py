"""A film of each eye: which frames are of one time, where a film lost some, says another rate, or is given twice.

The wall stands across the view and slides by 4 px a frame: the second eye's film, of what the first one's shows two
frames later, has 8 px of disparity, and a frame more or less another 4.
"""

from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from haustra.core.errors import HaustraError
from pipeline.config import StereoSettings
from pipeline.input.stereo.stereo_source import StereoSource
from tests.helpers.videos import textured_frames, without_packets, write_video

FOCAL, BASELINE, DISPARITY = 80.0, 4.0, 8
COUNT = 60
FRAMES = textured_frames(COUNT + 2)
EYES = {"left": FRAMES[:COUNT], "right": FRAMES[2:]}


def rig(folder: Path) -> str:
    matrix = f"[[{FOCAL}, 0, 79.5], [0, {FOCAL}, 79.5], [0, 0, 1]]"
    turn, none = "[[1, 0, 0], [0, 1, 0], [0, 0, 1]]", "[0, 0, 0, 0, 0]"
    path = folder / "rig.json"
    path.write_text(
        f'{{"M1": {matrix}, "D1": {none}, "M2": {matrix}, "D2": {none}, "R": {turn}, "T": [{-BASELINE}, 0, 0],'
        ' "image_width": 160, "image_height": 160}'
    )
    return str(path)


def film(folder: Path, eye: str, fps: int = 30) -> Path:
    return write_video(folder / f"{eye}.ts", EYES[eye], fps, g="10", bf="0", sc_threshold="0")


def disparities(source: StereoSource) -> list[float]:
    """Pixels, the median of each frame."""
    found = []
    for _ in source:
        depth = source.depth_mm()
        assert depth is not None
        found.append(FOCAL * BASELINE / float(np.median(depth[depth > 0])))
    return found


def opened(folder: Path, left: Path, right: Path) -> StereoSource:
    return StereoSource(left, StereoSettings(calibration=rig(folder), right=str(right)))


@pytest.mark.parametrize("holed", [pytest.param("left", marks=pytest.mark.slow), "right"])
def test_after_frames_that_one_film_lost_both_are_of_one_time(tmp_path: Path, holed: str) -> None:
    films = {eye: film(tmp_path, eye) for eye in EYES}
    without_packets(films[holed], range(23, 26))
    source = opened(tmp_path, films["left"], films["right"])
    found = disparities(source)
    assert COUNT - 10 <= len(found) < COUNT
    np.testing.assert_allclose(found, DISPARITY, atol=0.5)
    if holed == "right":
        assert any("that right.ts has no picture of are left out" in note for note in source.notes)
        assert any(note.startswith("right.ts: left out") for note in source.notes)


@pytest.mark.parametrize("holed", ["left", pytest.param("right", marks=pytest.mark.slow)])
def test_a_film_whose_first_picture_is_damaged_is_of_the_time_of_the_other(tmp_path: Path, holed: str) -> None:
    films = {
        eye: write_video(tmp_path / f"{eye}.mp4", frames, g="10", bf="0", sc_threshold="0")
        for eye, frames in EYES.items()
    }
    with av.open(str(films[holed])) as opened_film:
        first = bytes(next(opened_film.demux(video=0)))
    films[holed].write_bytes(films[holed].read_bytes().replace(first, b"\xa7" * len(first)))
    found = disparities(opened(tmp_path, films["left"], films["right"]))
    np.testing.assert_allclose(found, [DISPARITY] * (COUNT - 10), atol=0.5)


@pytest.mark.parametrize("holed", ["left", "right"])
def test_after_a_picture_that_cannot_be_read_both_are_of_one_number(tmp_path: Path, holed: str) -> None:
    for eye, frames in EYES.items():
        (tmp_path / eye).mkdir()
        for number, rgb in enumerate(frames[:8]):
            cv2.imwrite(str(tmp_path / eye / f"{number:03d}.png"), rgb[..., ::-1])
    (tmp_path / holed / "003.png").write_bytes(b"damaged")
    found = disparities(opened(tmp_path, tmp_path / "left", tmp_path / "right"))
    np.testing.assert_allclose(found, [DISPARITY] * 7, atol=0.5)


def test_films_that_say_two_rates_are_paired_by_number_aloud(tmp_path: Path) -> None:
    source = opened(tmp_path, film(tmp_path, "left"), film(tmp_path, "right", fps=25))
    np.testing.assert_allclose(disparities(source), [DISPARITY] * COUNT, atol=0.5)
    assert any("say 30 and 25 frames a second: their frames were paired by number" in note for note in source.notes)


def test_one_film_given_for_both_eyes_is_one_sentence(tmp_path: Path) -> None:
    left = film(tmp_path, "left")
    with pytest.raises(HaustraError, match="is one eye's film given twice"):
        opened(tmp_path, left, left).check()
