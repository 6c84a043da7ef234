"""Burned-in text against what was drawn: it is found beside and over the picture, and nothing else is."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import shared, textured_frames
from pipeline.content import find_content
from pipeline.overlay import find_overlay

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


def test_where_nothing_moves_or_little_was_looked_at_nothing_is_told():
    frames = textured_frames(24, SIDE, 1, 5)
    assert not find_overlay([frames[0]] * 24).any()
    assert not find_overlay(with_clock(frames[:5], (6, 14), COLOURS[0])[0]).any()


@pytest.mark.parametrize("name", ["sinus", "ctcolon/rgb"])
def test_real_and_path_traced_films_without_text_keep_their_picture(name):
    paths = sorted(p for p in shared(name).iterdir() if p.stem.isdigit())
    frames = [cv2.imread(str(path))[..., ::-1] for path in paths[:: max(1, len(paths) // 24)]]
    assert not find_overlay(frames).any()
