"""Parts of a film in which the processor shows a cut-out of its picture enlarged."""

import re

import cv2
import numpy as np
import pytest

from haustra.core.progress import SilentProgress
from pipeline.config import Config
from pipeline.input.content_area import find_content
from pipeline.input.frame_quality import FrameJudge
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


@pytest.mark.parametrize("factor", [1.2, 1.3, 1.5, 2.0])
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


def approach(sides):
    """A plane across the view from nearer and nearer: cut-outs of these sides, pixels."""
    wall, views = textured_frames(1, 480)[0], []
    for side in sides:
        begin = (480 - side) // 2
        cut = wall[begin : begin + side, begin : begin + side]
        views.append(cv2.resize(cut, (160, 160), interpolation=cv2.INTER_AREA))
    return views


def judged(frames, numbers=None):
    """Numbers of the frames that are of another zoom, and what is told."""
    numbers = list(range(len(frames))) if numbers is None else numbers
    zoom, notes = DigitalZoom(np.full(frames[0].shape[:2], 255, np.uint8)), []
    for number, frame in zip(numbers, frames, strict=True):
        zoom.remember(frame, number)
    found = zoom.judged([(number, 0.1 * number, "used") for number in numbers] + [(999, 99.9, "blurred")], notes)
    assert found[-1] == (999, 99.9, "blurred")
    return [frame for frame, _, verdict in found if verdict == "other zoom"], notes


STILL = [480, 479, 478, 477, 476, 475]


@pytest.mark.parametrize(
    ("sides", "numbers"),
    [
        ([round(480 / 1.1**k) for k in range(12)], None),
        ([*STILL, 432, 393, 357, 325, *(324 - k for k in range(6))], None),
        (
            [*STILL, *(395 - k for k in range(6)), *(k + 470 for k in range(6))],
            [*range(6), *range(26, 32), *range(52, 58)],
        ),
    ],
    ids=["at an even pace", "after a pause", "while the frames are blurred"],
)
def test_a_scope_that_comes_straight_at_a_wall_is_no_zoom(sides, numbers):
    """A plane across the view grows by one factor as well."""
    assert judged(approach(sides), numbers) == ([], [])


def tube(zooms, count=50):
    """A withdrawal at the zooms of ranges of frames."""
    factors = [next((factor for frames, factor in zooms.items() if k in frames), 1.0) for k in range(count)]
    return [enlarged(render(camera_at(k, 0.2)), factor) for k, factor in enumerate(factors)]


@pytest.mark.parametrize(
    ("zooms", "left_out", "told"),
    [
        ({range(20, 30): 1.5}, range(20, 30), "10 of the frames between 2.0 and 2.9 s are shown 1.5 times as large"),
        ({range(20, 50): 1.5}, (), r"the picture may be shown at several zooms \(1.5 times as large from 2.0 s on\)"),
        ({range(8, 45): 1.5}, (), "the picture may be shown at several zooms .1.5 times as large from 0.8 s on"),
        (
            {range(10, 15): 1.5, range(15, 20): 2.0},
            range(10, 20),
            "10 of the frames between 1.0 and 1.9 s are shown 1.5 times as large",
        ),
        (
            {range(10, 14): 1.5, range(30, 36): 2.0},
            [*range(10, 14), *range(30, 36)],
            "10 of the frames between 1.0 and 3.5 s are shown 1.5 and 2 times as large",
        ),
    ],
    ids=["there and back", "no way back", "most of the film", "one in the other", "two"],
)
def test_frames_between_a_change_and_the_change_back_are_left_out(zooms, left_out, told):
    out, (note,) = judged(tube(zooms))
    assert out == list(left_out)
    assert re.match(told, note)


def test_an_end_that_is_not_seen_costs_no_frame():
    """The way back comes in a leap: what is told is when it began."""
    frames = tube({range(15, 25): 1.5})
    out, (note,) = judged(frames[:25] + [render(camera_at(k + 60, 0.2)) for k in range(25)])
    assert out == []
    assert "several zooms (1.5 times as large from 1.5 s on)" in note


def test_a_run_leaves_frames_at_another_zoom_out(tmp_path):
    frames = [enlarged(frame, 1.4 if 20 <= k < 32 else 1.0) for k, frame in enumerate(textured_frames(48, step=2))]
    film = write_video(tmp_path / "a.mp4", frames, fps=25)
    with create_workspace(tmp_path / "run", film, Config(), False) as workspace:
        found = read_frames(Source(film), "auto", Config().frames, workspace, SilentProgress())
        notes, images = workspace.result("frames")["notes"], workspace.images.glob("*.jpg")
        assert sorted(int(path.stem) for path in images) == found.index.tolist()
    assert found.verdicts == {"used": 36, "other zoom": 12}
    assert found.index.tolist() == [*range(20), *range(32, 48)]
    assert [note for note in notes if "12 of the frames between 0.8 and 1.2 s are shown 1.4 times" in note]


@pytest.mark.slow
@pytest.mark.parametrize("stride", [1, 4])
def test_real_films_have_one_zoom(stride):
    films = sorted(shared("realclips").glob("*.mp4"))
    assert films
    for path in films:
        frames = [frame.rgb for frame in Source(path)]
        content, judge, notes = find_content(frames[::24]).mask, FrameJudge(), []
        zoom, looked_at = DigitalZoom(content), []
        for k, frame in enumerate(frames[::stride]):
            looked_at.append((k, float(k), judge.judge(frame, content)))
            if looked_at[-1][2] == "used":
                zoom.remember(frame, k)
        assert zoom.judged(looked_at, notes) == looked_at
        assert notes == []
