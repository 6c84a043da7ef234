"""A session goes on without the processes beside it."""

from __future__ import annotations

from haustra.core.errors import HaustraError
from pipeline.config import Config
from pipeline.live import session
from pipeline.live.capture.live_film import PlayedFilm
from pipeline.live.page.live_state import LiveState
from tests.helpers.videos import textured_frames, write_video

COUNT = 40


class Broken:
    """Stands for the process of depth or of reviews, and ends at its first job."""

    def __init__(self, setup):
        self.setup = setup

    def __call__(self, job):
        raise HaustraError("the disk is full")


def test_frames_are_read_to_the_end_though_nothing_is_completed(tmp_path, monkeypatch):
    monkeypatch.setattr(session, "DenseWorker", Broken)
    monkeypatch.setattr(session, "ReviewWorker", Broken)
    film = PlayedFilm(write_video(tmp_path / "film.mp4", textured_frames(COUNT, 96), 60))
    state = LiveState(film.name)
    session.LiveSession(film, tmp_path, Config(), state).run()
    assert state.counts.came == COUNT
    assert state.counts.shown == 0
    assert "the disk is full; the recording goes on" in state.sentences
