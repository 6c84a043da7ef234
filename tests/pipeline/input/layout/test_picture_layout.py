"""Parts of a film in which the processor shows its picture elsewhere, larger or smaller."""

import cv2
import numpy as np
import pytest

from haustra.core.progress import SilentProgress
from pipeline.config import Config
from pipeline.input.content_area import find_content
from pipeline.input.frames import read_frames
from pipeline.input.layout.picture_layout import WINDOW, PictureLayout
from pipeline.input.video import Source
from pipeline.run_folder.creating import create_workspace
from tests.helpers.real_data import shared
from tests.helpers.videos import textured_frames, write_video

SCREEN = (240, 400, 3)


def on_screen(frames, box):
    """Frames as the processor shows them in a box (x, y, width, height) of a black screen."""
    x, y, width, height = box
    shown = []
    for frame in frames:
        screen = np.zeros(SCREEN, np.uint8)
        screen[y : y + height, x : x + width] = cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA)
        shown.append(screen)
    return shown


def told(frames, usual):
    layout, found = PictureLayout(find_content(usual)), []
    for k, frame in enumerate(frames):
        found.append(layout.is_elsewhere(frame, 0.1 * k))
        if not found[-1]:
            layout.remember(0.1 * k)
    return found, layout.notes


@pytest.mark.parametrize("box", [(200, 20, 200, 200), (20, 0, 360, 240)], ids=["to the right", "larger"])
def test_a_picture_that_moves_or_grows_lies_elsewhere(box):
    usual = on_screen(textured_frames(20), (0, 20, 200, 200))
    elsewhere, notes = told([*usual, *on_screen(textured_frames(10), box), *usual[:5]], usual)
    assert elsewhere == [False] * 20 + [True] * 10 + [False] * 5
    (note,) = notes
    assert note.startswith(
        "10 of the frames between 2.0 and 2.9 s have their picture where the film has its black border"
    )


def test_a_picture_that_shrinks_within_its_old_place_is_told_once_two_windows_of_it_have_passed():
    usual = on_screen(textured_frames(20), (0, 0, 400, 240))
    small = on_screen(textured_frames(2 * WINDOW), (100, 60, 200, 120))
    elsewhere, notes = told([*usual, *(usual + usual)[: WINDOW - 20], *small], usual)
    assert not any(elsewhere)
    (note,) = notes
    assert "may be shown smaller for a while (10.0 to 14.9 s: 25 % of its place is lit" in note


@pytest.mark.parametrize("dark", [slice(None), slice(220, None)], ids=["lamp off", "one side"])
def test_dark_tissue_is_no_smaller_picture(dark):
    """It has the sensor's noise, and a lamp that is off lights nothing."""
    rng = np.random.default_rng(0)
    usual = on_screen(textured_frames(20), (0, 0, 400, 240))
    frames = [frame.copy() for frame in (usual * 8)[: 3 * WINDOW]]
    for frame in frames:
        frame[:, dark] = rng.normal(10, 5, frame[:, dark].shape).clip(0, 255)
    assert told(frames, usual) == ([False] * len(frames), [])


def test_an_inset_beside_the_picture_is_no_other_layout():
    """As ScopeGuide's, or a second picture's: the picture itself has not moved."""
    usual = on_screen(textured_frames(20), (0, 20, 200, 200))
    with_inset = [frame.copy() for frame in usual]
    for frame in with_inset:
        frame[40:200, 230:390] = 120
    assert told(with_inset, usual) == ([False] * 20, [])


def test_a_side_that_was_dark_at_first_is_no_other_layout():
    """The content was found without it."""
    whole = on_screen(textured_frames(20), (40, 20, 320, 200))
    at_first = [frame.copy() for frame in whole]
    for frame in at_first:
        frame[:, 220:] = 3
    assert told(whole, at_first) == ([False] * 20, [])


def test_a_clock_beside_the_picture_is_no_other_layout():
    usual = on_screen(textured_frames(20), (0, 20, 200, 200))
    with_clock = [cv2.putText(frame.copy(), "12:34:56", (220, 60), 0, 1.0, (255, 255, 255), 2) for frame in usual]
    assert told(with_clock, usual) == ([False] * 20, [])


def test_a_dark_lumen_is_no_smaller_picture():
    """Its outline counts, not what is dark within."""
    y, x = np.mgrid[:240, :400]
    wall = np.hypot(x - 200, y - 120) > 90
    usual = on_screen(textured_frames(20), (0, 0, 400, 240))
    frames = [np.where(wall[..., None], frame, 3).astype(np.uint8) for frame in (usual * 6)[: 2 * WINDOW]]
    assert told(frames, usual) == ([False] * len(frames), [])


def test_a_run_leaves_the_other_layout_out_and_says_so(tmp_path):
    """The content is found in the film's beginning: the picture moves after 20 s."""
    usual = on_screen(textured_frames(24), (0, 20, 200, 200))
    moved = on_screen(textured_frames(24)[::-1], (200, 20, 200, 200))
    film = write_video(tmp_path / "a.mp4", [*(usual * 30)[:700], *moved], fps=25)
    source = Source(film)
    with create_workspace(tmp_path / "run", film, Config(), False) as workspace:
        frames = read_frames(source, "auto", Config().frames, workspace, SilentProgress())
        notes = workspace.result("frames")["notes"]
    assert frames.verdicts["other layout"] == 24
    assert frames.index.max() < 700
    assert [note for note in notes if "24 of the frames between 28.0 and 28.9 s" in note]


def test_real_films_have_one_layout():
    films = sorted(shared("realclips").glob("*.mp4"))
    assert films
    for path in films:
        frames = [frame.rgb for frame in Source(path)]
        area = find_content(frames[: 24 * 25 : 25] if len(frames) > 600 else frames[::3])
        assert (area.mask == 0).mean() > 0.05, path.name  # there is a border
        layout = PictureLayout(area)
        for k, frame in enumerate(frames):
            assert not layout.is_elsewhere(frame, float(k)), path.name
            layout.remember(float(k))
        assert layout.notes == [], path.name
