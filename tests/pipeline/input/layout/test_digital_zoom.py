"""Parts of a film in which the processor shows a cut-out of its picture enlarged."""

import re

import cv2
import numpy as np
import pytest

from haustra.core.progress import SilentProgress
from pipeline.config import Config
from pipeline.input.frames import read_frames
from pipeline.input.layout.digital_zoom import DigitalZoom, zoom_between
from pipeline.input.video import Source
from pipeline.run_folder.creating import create_workspace
from tests.helpers.real_data import shared
from tests.helpers.tubes.textured_tube import MASK, camera_at, render
from tests.helpers.videos import textured_frames, write_video


def enlarged(rgb, factor):
    """A cut-out about the middle, at the size of the whole."""
    height, width = rgb.shape[:2]
    matrix = np.array([[factor, 0, (1 - factor) * (width - 1) / 2], [0, factor, (1 - factor) * (height - 1) / 2]])
    return cv2.warpAffine(rgb, matrix, (width, height), flags=cv2.INTER_AREA, borderMode=cv2.BORDER_REFLECT)


def grey(rgb):
    return cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)


@pytest.mark.parametrize("factor", [1.1, 1.3, 1.5, 2.0])
@pytest.mark.parametrize("back", [False, True])
def test_the_factor_is_found_while_the_scope_moves_on(factor, back):
    before, after = render(camera_at(10, 0.1)), enlarged(render(camera_at(11, 0.1)), factor)
    found = zoom_between(grey(after), grey(before), MASK) if back else zoom_between(grey(before), grey(after), MASK)
    assert found == pytest.approx(1 / factor if back else factor, rel=0.02)


@pytest.mark.parametrize("step", [1, 3, 6])
def test_a_scope_that_moves_is_no_zoom(step):
    """Forwards and backwards, by up to a quarter of the tube's radius in a frame."""
    views = [grey(render(camera_at(k))) for k in (10, 10 + step)]
    assert zoom_between(*views, MASK) == 1.0
    assert zoom_between(*views[::-1], MASK) == 1.0


def test_a_scope_that_comes_straight_at_a_wall_at_an_even_pace_is_no_zoom():
    """A plane across the view grows by one factor as well; what tells it is that it grew before."""
    wall = textured_frames(1, 480)[0]
    zoom = DigitalZoom(np.full((160, 160), 255, np.uint8))
    for k in range(12):
        side = round(480 / 1.1**k)
        begin = (480 - side) // 2
        cut = wall[begin : begin + side, begin : begin + side]
        zoom.remember(cv2.resize(cut, (160, 160), interpolation=cv2.INTER_AREA), k)
    looked_at, notes = [(k, 0.1 * k, "used") for k in range(12)], []
    assert zoom.judged(looked_at, notes) == looked_at
    assert notes == []


@pytest.mark.parametrize(
    ("zooms", "left_out", "told"),
    [
        ({range(20, 30): 1.5}, range(20, 30), "10 of the frames between 2.0 and 2.9 s are shown 1.5 times as large"),
        ({range(20, 50): 1.5}, range(20), "20 of the frames between 0.0 and 1.9 s are shown 0.6[67] times as large"),
        (
            {range(10, 15): 1.5, range(15, 20): 2.0},
            range(10, 20),
            "10 of the frames between 1.0 and 1.9 s are shown 1.5 and 2 times as large",
        ),
    ],
)
def test_frames_at_another_zoom_than_most_are_left_out(zooms, left_out, told):
    zoom = DigitalZoom(MASK)
    for k in range(50):
        factor = next((factor for frames, factor in zooms.items() if k in frames), 1.0)
        zoom.remember(enlarged(render(camera_at(k, 0.2)), factor), k)
    notes = []
    judged = zoom.judged([(k, 0.1 * k, "used") for k in range(50)] + [(50, 5.0, "blurred")], notes)
    assert [frame for frame, _, verdict in judged if verdict == "other layout"] == list(left_out)
    assert judged[-1] == (50, 5.0, "blurred")
    (note,) = notes
    assert re.match(told, note)
    assert ("a camera file of the whole picture is wrong" in note) == (0 in left_out)


def test_a_run_leaves_frames_at_another_zoom_out(tmp_path):
    frames = [enlarged(frame, 1.4 if 20 <= k < 32 else 1.0) for k, frame in enumerate(textured_frames(48, step=2))]
    film = write_video(tmp_path / "a.mp4", frames, fps=25)
    with create_workspace(tmp_path / "run", film, Config(), False) as workspace:
        found = read_frames(Source(film), "auto", Config().frames, workspace, SilentProgress())
        notes, images = workspace.result("frames")["notes"], workspace.images.glob("*.jpg")
        assert sorted(int(path.stem) for path in images) == found.index.tolist()
    assert found.verdicts == {"used": 36, "other layout": 12}
    assert found.index.tolist() == [*range(20), *range(32, 48)]
    assert [note for note in notes if "12 of the frames between 0.8 and 1.2 s are shown 1.4 times" in note]


@pytest.mark.slow
def test_real_films_have_one_zoom():
    for path in sorted(shared("realclips").glob("*.mp4")):
        frames = [frame.rgb for frame in Source(path)]
        zoom = DigitalZoom(np.full(frames[0].shape[:2], 255, np.uint8))
        for k, frame in enumerate(frames):
            zoom.remember(frame, k)
        looked_at, notes = [(k, float(k), "used") for k in range(len(frames))], []
        assert zoom.judged(looked_at, notes) == looked_at, notes
