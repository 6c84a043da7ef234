"""The whole of `haustra live`: session, page, and the run of the recording."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from haustra.core.errors import HaustraError
from haustra.core.progress import Progress, ProgressCallback
from pipeline.config import Config
from pipeline.finished_run import Run
from pipeline.input.video import RawFrame
from pipeline.live.capture.live_film import LiveFilm, open_film
from pipeline.live.finish import begin_record, finish_run, read_record, remove_scratch, take_folder, write_record
from pipeline.live.keyboard import watched_keyboard
from pipeline.live.page.live_server import LivePage
from pipeline.live.page.live_state import LiveState
from pipeline.live.session import LiveSession

LAST_LOOK_S = 2.0  # for the page to be told how it ended


class _BegunFilm:
    """A film whose session takes the place of what its folder holds with the first picture: a source that gives none
    must cost no earlier run."""

    def __init__(self, film: LiveFilm, begin: Callable[[], None]) -> None:
        self.name, self.recording, self._film, self._begin = film.name, film.recording, film, begin
        self.is_begun = False

    def frames(self, stopped: threading.Event) -> Iterator[RawFrame]:
        for frame in self._film.frames(stopped):
            if not self.is_begun:
                self._begin()
                self.is_begun = True
            yield frame


class _ToldProgress:
    """Progress of the run at the end, on the page and where it was to go anyway."""

    def __init__(self, progress: Progress, state: LiveState) -> None:
        self._progress, self._state = progress, state

    @contextmanager
    def bar(self, label: str, total: int | None) -> Iterator[ProgressCallback]:
        with self._progress.bar(label, total) as advance:

            def both(done: int, total: int | None = total, note: str = "") -> None:
                self._state.finishing = (label, done, total)
                advance(done, total, note)

            yield both

    def log(self, sentence: str) -> None:
        self._state.say(sentence)
        self._progress.log(sentence)


def live(
    source: str,
    folder: Path,
    config: Config,
    progress: Progress,
    *,
    port: int = 0,
    open_browser: bool = True,
    loops: int = 1,
    grows: bool = False,
    overwrite: bool = False,
    finish: bool = True,
) -> Run | None:
    """Show a source while it is filmed, then reconstruct what was recorded into `folder`.

    Ends with the source, by `q`, by Ctrl-C or from the page. HaustraError, one sentence, where the source cannot be
    opened or showed nothing; a source that is lost later ends the session like any other end.
    finish: False leaves the run to `--resume`.
    """
    shown = open_film(source, folder, loops, grows)
    film = _BegunFilm(shown, lambda: begin_record(folder, shown.name, shown.recording, config))
    state = LiveState(film.name)
    page = LivePage(state, port)  # before the folder is made: a port that is taken costs nothing
    try:
        lock = take_folder(folder, overwrite)
    except HaustraError:
        page.server_close()
        raise
    with _shown(page, open_browser, progress.log):
        progress.log("the network is being loaded, which takes some seconds")
        try:
            with watched_keyboard(state.stop_asked):
                LiveSession(film, folder, config, state).run()
        except HaustraError as error:
            state.phase, state.advice = "failed", str(error)
            state.wait_until_told(LAST_LOOK_S)
            raise
        finally:
            try:
                if not film.is_begun:  # the corrected command may have the folder
                    remove_scratch(folder)
                else:
                    write_record(folder, replace(read_record(folder), figures=state.figures()))
            finally:
                lock.release()
        if not film.is_begun:
            raise HaustraError(f"the session ended before {film.name} gave a picture")
        for sentence in (*state.sentences, state.summary, f"the film: {film.recording}"):
            progress.log(sentence)
        if not finish:
            state.phase = "recorded"
            progress.log(f"the run of it: haustra live --resume -o {folder}")
            state.wait_until_told(LAST_LOOK_S)
            return None
        state.phase = "finishing"
        run = finish_run(folder, _ToldProgress(progress, state))
        state.phase = "done"
        state.wait_until_told(LAST_LOOK_S)
        return run


@contextmanager
def _shown(page: LivePage, open_browser: bool, say: Callable[[str], None]) -> Iterator[None]:
    page.show(open_browser)
    say(f"{page.address} shows the surface as it grows; q or Ctrl-C ends it")
    try:
        yield
    finally:
        page.end()
