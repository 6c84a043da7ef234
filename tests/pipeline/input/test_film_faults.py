"""Interlaced film that no flag announces, and colours that were lit one after the other."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.input.film_faults import MOVING_FRAMES, colour_shift, look_at, row_change
from pipeline.input.video import Source
from tests.helpers.real_data import shared
from tests.helpers.videos import textured_frames, write_video

COUNT = 2 * MOVING_FRAMES + 2


def still_of(seed: int, step: int, noise: float = 0.0) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    frames = textured_frames(COUNT, seed=seed, step=step)
    return [np.clip(frame + rng.normal(0, noise, frame.shape), 0, 255).astype(np.uint8) for frame in frames]


def combed(frames: list[np.ndarray], first: int) -> list[np.ndarray]:
    """Rows `first`, `first` + 2, ... of every second frame, the others of the frame after."""
    made = []
    for one, two in zip(frames[::2], frames[1::2], strict=True):
        whole = two.copy()
        whole[first::2] = one[first::2]
        made.append(whole)
    return made


def lit_in_turn(frames: list[np.ndarray]) -> list[np.ndarray]:
    """Red, green and blue of frames that follow each other."""
    triples = zip(frames, frames[1:], frames[2:], strict=False)
    return [np.dstack([a[..., 0], b[..., 1], c[..., 2]]) for a, b, c in triples]


@pytest.mark.parametrize("noise", [0.0, 4.0])
@pytest.mark.parametrize("step", [2, 4, 7])
@pytest.mark.parametrize("first", [0, 1])
def test_combs_are_seen_where_they_are_and_only_there(first: int, step: int, noise: float) -> None:
    frames = still_of(step, step, noise)
    assert not look_at(frames).combed
    assert look_at(combed(frames + frames, first)).combed


@pytest.mark.parametrize("angle", range(0, 180, 18))
def test_stripes_of_any_direction_are_no_combs(angle: int) -> None:
    """Folds and vessels are not finer than two rows."""
    y, x = np.mgrid[:160, :160]
    along = x * np.cos(np.radians(angle)) + y * np.sin(np.radians(angle))
    frames = [
        np.repeat((128 + 90 * np.sin((along + 3 * k) * 2 * np.pi / 9))[..., None], 3, 2).astype(np.uint8)
        for k in range(COUNT)
    ]
    assert not look_at(frames).combed
    assert row_change(frames[0]) < 1


def test_noise_alone_is_no_comb() -> None:
    rng = np.random.default_rng(0)
    assert not look_at(rng.integers(0, 256, (160, 160, 3), dtype=np.uint8) for _ in range(COUNT)).combed


@pytest.mark.parametrize("step", range(1, 11))
def test_colours_lit_in_turn_are_told_with_their_distance(step: int) -> None:
    frames = still_of(step, step)
    plain, fringed = look_at(frames), look_at(lit_in_turn(frames))
    assert plain.fringe_px == 0
    assert fringed.fringe_px == pytest.approx(2 * step, abs=0.3)
    assert f"{fringed.fringe_px:.1f} px apart" in fringed.notes[0]


@pytest.mark.parametrize("size", [(160, 160), (202, 150), (135, 225), (161, 243)])
def test_pictures_of_any_size_without_colour_have_no_fringe(size: tuple[int, int]) -> None:
    """OpenCV pads a side to a length that it transforms fast, and is off by half a pixel where that is odd."""
    grey = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 256, size, dtype=np.uint8), (0, 0), 2)
    picture = np.dstack([cv2.equalizeHist(grey)] * 3)
    assert colour_shift(picture) == pytest.approx(0, abs=1e-3)
    picture[..., 2] = np.roll(picture[..., 2], 3, axis=1)
    assert colour_shift(picture) == pytest.approx(3, abs=0.3)


def test_a_lens_that_spreads_colours_outwards_is_no_such_processor() -> None:
    def spread(frame: np.ndarray) -> np.ndarray:
        larger = cv2.warpAffine(frame[..., 2], cv2.getRotationMatrix2D((80, 80), 0, 1.03), (160, 160))
        return np.dstack([frame[..., 0], frame[..., 1], larger])

    assert look_at(map(spread, still_of(5, 4))).fringe_px == 0


@pytest.mark.parametrize("gain", [0.5, 1.0])
@pytest.mark.parametrize("step", [1, 3, 6])
def test_rows_of_unlike_gain_on_a_smooth_wall_are_no_combs(step: int, gain: float) -> None:
    """As of a sensor whose two greens differ, or of line noise: nothing is of another time."""
    rng = np.random.default_rng(step)
    wall = cv2.GaussianBlur(rng.uniform(0, 255, (160, 400)), (0, 0), 2.0)
    wall = 128 + (wall - wall.mean()) / wall.std() * 8
    rows = np.where(np.arange(160) % 2, gain, -gain)[:, None]
    frames = [np.repeat((wall[:, step * k : step * k + 160] + rows)[..., None], 3, 2) for k in range(COUNT)]
    assert not look_at([np.rint(frame).astype(np.uint8) for frame in frames]).combed


def test_rows_that_differ_while_the_picture_stands_are_no_combs() -> None:
    rows = np.where(np.arange(160) % 2, 6, -6)[:, None, None]
    standing = [still_of(2, 0)[0]] * 6
    frames = [np.clip(frame.astype(int) + rows, 0, 255).astype(np.uint8) for frame in standing + still_of(2, 4)]
    assert not look_at(frames).combed


def test_a_film_that_stands_says_nothing() -> None:
    assert not look_at(combed(still_of(0, 0), 0)).notes


def test_an_unflagged_film_gives_its_upper_field(tmp_path: Path) -> None:
    frames = still_of(3, 4)
    film = write_video(tmp_path / "film.mp4", combed(frames + frames, 0))
    source = Source(film)
    shown = [frame.rgb for frame in source]
    assert sum("interlaced though no flag" in note for note in source.notes) == 1
    assert max(row_change(rgb) for rgb in shown) < 1
    for rgb, truth in zip(shown[:5], frames[::2], strict=False):
        assert np.abs(rgb[::2].astype(int) - truth[::2]).mean() < 6
    assert [frame.rgb.tobytes() for frame in source] == [rgb.tobytes() for rgb in shown]


def test_rows_of_two_eyes_stay_two_eyes(tmp_path: Path) -> None:
    frames = still_of(3, 4)
    source = Source(write_video(tmp_path / "film.mp4", combed(frames + frames, 0)))
    source.rows_are_eyes = True
    assert max(row_change(frame.rgb) for frame in source) > 1.1
    assert not source.notes


def test_a_real_colonoscopy_has_neither() -> None:
    source = Source(shared("realclips") / "gastrolab_normal.mp4")
    next(iter(source))
    assert not source.notes
