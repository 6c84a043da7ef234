"""The way of one keyframe from the tracker to the last adjustment: the files that ARCHITECTURE.md lists, and no other.

Followed on a run: a file is on the way if a function of it has the keyframe, or a map that holds keyframes, among its
variables. What works on arrays (`pipeline.matching`, `pipeline.optimization`, `haustra.core`) never does.
"""

import re
import sys
import threading
from pathlib import Path

import pytest

from haustra.core.progress import SilentProgress
from pipeline.config import Config
from pipeline.frontend.odometry import front_end
from pipeline.frontend.odometry.frame_io import frame_features
from pipeline.frontend.odometry.tracking import Tracker
from pipeline.mapping.local_map import Keyframe, LocalMap
from tests.helpers.tubes.textured_tube import camera_at, render, stored

ROOT = Path(__file__).parents[1]
MOST_FILES = 5
DEEP = 2  # attributes and items that are looked into


def listed() -> list[str]:
    """The numbered files of the section in ARCHITECTURE.md."""
    section = (ROOT / "ARCHITECTURE.md").read_text().split("## The way of one keyframe")[1].split("\n## ")[0]
    return re.findall(r"^\d+\. `([\w/]+\.py)`", section, re.MULTILINE)


def holds(value: object, deep: int = DEEP) -> bool:
    if isinstance(value, LocalMap | Keyframe):
        return True
    if deep == 0:
        return False
    if isinstance(value, list | tuple):
        return any(holds(item, deep - 1) for item in value[:2])
    ours = type(value).__module__.startswith("pipeline.")
    return ours and any(holds(item, deep - 1) for item in vars(value).values())


class Trace:
    """Files of ours whose functions had a keyframe or map while it was on."""

    def __init__(self) -> None:
        self.on = False
        self.files: set[str] = set()

    def __call__(self, frame, event, argument) -> None:
        file = frame.f_code.co_filename
        if event != "return" or not self.on or not file.startswith(str(ROOT / "pipeline")) or file in self.files:
            return
        if any(map(holds, frame.f_locals.values())):
            self.files.add(file)

    def between(self, monkeypatch) -> None:
        """On from the tracker's first keyframe to the end of the last adjustment."""
        process, adjust = Tracker.process, front_end.adjust_maps

        def processed(*arguments):
            outcome = process(*arguments)
            self.on = self.on or outcome == "keyframe"
            return outcome

        def adjusted(*arguments, **named):
            held = adjust(*arguments, **named)
            assert held != [None]  # to features
            sys.setprofile(None)
            self.on = False
            return held

        monkeypatch.setattr(Tracker, "process", processed)
        monkeypatch.setattr(front_end, "adjust_maps", adjusted)


@pytest.fixture
def trace(tmp_path, monkeypatch):
    workspace, frames = stored(tmp_path, [render(camera_at(k)) for k in range(24)])
    trace = Trace()
    trace.between(monkeypatch)
    threading.setprofile(trace)
    sys.setprofile(trace)
    try:
        front_end.track_frames(
            frames, frame_features(workspace), Config().front_end_settings, workspace, SilentProgress()
        )
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    return {Path(file).relative_to(ROOT).as_posix() for file in trace.files}


def test_it_crosses_the_files_that_are_listed(trace):
    assert trace == set(listed())
    assert len(trace) <= MOST_FILES
