"""Burned-in text against what was drawn: it is found beside and over the picture, and nothing else is."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.input.burned_in_text import find_overlay
from pipeline.input.content_area import find_content
from tests.helpers.real_data import shared
from tests.helpers.videos import textured_frames

SIDE = 320
COLOURS = [(255, 255, 255), (90, 255, 120), (250, 230, 40)]


def octagon(cut):
    y, x = np.indices((SIDE, SIDE))
    fold_x, fold_y = np.minimum(x, SIDE - 1 - x), np.minimum(y, SIDE - 1 - y)
    return fold_x + fold_y >= cut


def with_clock(frames, place, colour):
    """Frames with a name and a running clock, and where any frame has a stroke."""
    drawn, strokes = [], np.zeros(frames[0].shape[:2], bool)
    for number, frame in enumerate(frames):
        ink = np.zeros_like(frame)
        for row, line in enumerate(["P. NOBODY", f"14:58:{number // 3:02d}:{7 * number % 30:02d}"]):
            where = place[0], place[1] + 13 * row
            cv2.putText(ink, line, where, cv2.FONT_HERSHEY_SIMPLEX, 0.38, (255, 255, 255), 1, cv2.LINE_AA)
        on = ink[..., 0] > 127
        drawn.append(np.where(on[..., None], np.uint8(colour), frame))
        strokes |= on
    return drawn, strokes


@given(st.integers(4, 200), st.integers(14, 290), st.sampled_from(COLOURS), st.integers(0, 99))
@settings(max_examples=12, deadline=None)
def test_text_is_found_wherever_it_stands_and_little_else(left, top, colour, seed):
    frames, strokes = with_clock(textured_frames(24, SIDE, seed, 5), (left, top), colour)
    found = find_overlay(frames)
    assert found[strokes].mean() > 0.97
    assert found.sum() < 4 * cv2.boundingRect(strokes.astype(np.uint8))[2] * 36


def test_text_that_touches_the_picture_does_not_make_the_border_part_of_it():
    """It did: the hull of picture and text took in the whole corner, and red-out was tracked by the letters in it."""
    lit = octagon(80)
    frames = [np.where(lit[..., None], frame, 0).astype(np.uint8) for frame in textured_frames(24, SIDE, 3, 5)]
    frames, strokes = with_clock(frames, (6, 14), COLOURS[0])
    content = find_content(frames).mask > 0
    assert not content[~lit].any()
    assert not content[strokes].any()
    assert content.sum() > 0.85 * lit.sum()


def test_a_clip_without_text_has_none():
    assert not find_overlay(textured_frames(24, SIDE, 1, 5)).any()


def test_a_line_across_the_picture_costs_the_line_alone():
    """It parts the lit disc in two, and both halves are the picture."""
    y, x = np.indices((SIDE, SIDE)) - (SIDE - 1) / 2
    lit = np.hypot(x, y) < 150
    frames = [np.where(lit[..., None], frame, 0).astype(np.uint8) for frame in textured_frames(24, SIDE, 3, 5)]
    plain = find_content(frames)
    for frame in frames:
        cv2.putText(frame, "ANONYMOUS PATIENT OF NOBODY", (2, 100), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (255, 255, 255), 1)
    found = find_content(frames)
    assert np.abs(np.subtract(found.box, plain.box)).max() <= 4
    lost = (plain.mask > 0) & (found.mask == 0)
    assert not found.mask[100 - 12 : 100, 40:260].any()
    assert lost[60:130].sum() > 0.95 * lost.sum()


def test_title_cards_do_not_hide_the_text():
    frames, strokes = with_clock(textured_frames(24, SIDE, 2, 5), (6, 14), COLOURS[0])
    frames[:3] = [np.full_like(frames[0], 90)] * 3
    assert find_overlay(frames)[strokes].mean() > 0.97


def test_a_panel_full_of_letters_beside_the_picture_is_found():
    frames = [np.pad(frame, ((0, 0), (SIDE, 0), (0, 0))) for frame in textured_frames(24, SIDE, 2, 5)]
    strokes = np.zeros(frames[0].shape[:2], bool)
    for frame in frames:
        for row in range(10):
            cv2.putText(frame, "PATIENT 0815", (8, 28 + 30 * row), cv2.FONT_HERSHEY_SIMPLEX, 0.8, (255, 255, 255), 2)
        strokes = frame[:, : SIDE - 8, 0] == 255
    assert find_overlay(frames)[:, : SIDE - 8][strokes].mean() > 0.9


def smooth(count):
    return cv2.blur(textured_frames(1, SIDE + 12 * count, 4)[0], (25, 25))


def with_busy_place(canvas, rng):
    """The canvas with 40 x 60 px in it as busy as letters."""
    canvas = canvas.copy()
    canvas[100:140, 160:220] = rng.integers(0, 2, (20, 30, 1), dtype=np.uint8).repeat(2, 0).repeat(2, 1) * 180
    return canvas


def test_in_a_view_that_stays_nothing_is_told_from_tissue():
    """Neither by noise, nor by a lamp that flickers; and too few frames tell nothing either."""
    rng = np.random.default_rng(0)
    view = with_busy_place(smooth(1)[:, :SIDE], rng)
    noisy = [np.clip(view * rng.uniform(0.95, 1.05) + rng.normal(0, 3, view.shape), 0, 255) for _ in range(24)]
    assert not find_overlay([view] * 24).any()
    assert not find_overlay([frame.astype(np.uint8) for frame in noisy]).any()
    frames, _ = with_clock(textured_frames(24, SIDE, 1, 5), (6, 14), COLOURS[0])
    assert find_overlay(frames).any()
    assert not find_overlay(frames[:5]).any()


def test_what_fills_half_of_the_picture_is_no_text():
    frames = textured_frames(24, SIDE, 1, 5)
    for frame in frames:
        frame[:, : SIDE // 2] = frames[0][:, : SIDE // 2]
    assert not find_overlay(frames).any()


def test_what_is_always_busy_but_never_the_same_is_no_text():
    """Ripples that run through a place have detail in every frame, and none in the median."""
    canvas, x = smooth(24), np.arange(80)
    frames = [canvas[:SIDE, 12 * k : 12 * k + SIDE].copy() for k in range(24)]
    for number, frame in enumerate(frames):
        ripples = 70 * np.sin(2 * np.pi * (x + number) / 8)[None, :, None]
        frame[100:140, 100:180] = np.clip(frame[100:140, 100:180] + ripples, 0, 255)
    assert not find_overlay(frames).any()


def test_what_a_camera_looks_at_for_half_of_a_clip_is_no_text():
    canvas = with_busy_place(smooth(24), np.random.default_rng(1))
    places = [0 if k < 14 else 12 * k for k in range(24)]
    assert not find_overlay([np.ascontiguousarray(canvas[:SIDE, x : x + SIDE]) for x in places]).any()


@pytest.mark.parametrize("name", ["sinus", "ctcolon/rgb"])
def test_real_and_path_traced_films_without_text_keep_their_picture(name):
    paths = sorted(p for p in shared(name).iterdir() if p.stem.isdigit())
    frames = [cv2.imread(str(path))[..., ::-1] for path in paths[:: max(1, len(paths) // 24)]]
    assert not find_overlay(frames).any()
