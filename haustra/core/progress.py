"""Progress of the stages: a bar in the terminal, or nothing at all when used as a library."""

import logging
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol

logger = logging.getLogger(__name__)


class ProgressCallback(Protocol):
    """Told how many steps are done, their number if it was not known before, and a few words on how it goes."""

    def __call__(self, done: int, total: int | None = None, note: str = "") -> None: ...


def no_progress(done: int, total: int | None = None, note: str = "") -> None:
    """Null progress callback."""


class Progress(Protocol):
    """How a stage reports what it does."""

    def bar(self, label: str, total: int | None) -> AbstractContextManager[ProgressCallback]: ...

    def log(self, sentence: str) -> None: ...


class SilentProgress:
    """The null object: sentences go to the log."""

    @contextmanager
    def bar(self, label: str, total: int | None) -> Iterator[ProgressCallback]:
        yield no_progress

    def log(self, sentence: str) -> None:
        logger.info(sentence)


class SaidOnce:
    """Passes on to another progress, but a sentence that was said already is not said again, as by a repeated step."""

    def __init__(self, progress: Progress) -> None:
        self.bar = progress.bar
        self._say = progress.log
        self._said: set[str] = set()

    def log(self, sentence: str) -> None:
        if sentence not in self._said:
            self._said.add(sentence)
            self._say(sentence)


class TerminalProgress:
    """Rich progress bars on standard error, one after the other."""

    def __init__(self) -> None:
        from rich.console import Console

        self.console = Console(stderr=True, highlight=False)

    @contextmanager
    def bar(self, label: str, total: int | None) -> Iterator[ProgressCallback]:
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as RichProgress

        columns = (
            TextColumn("{task.description:<22}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[note]}", markup=False),
        )
        with RichProgress(*columns, console=self.console) as bars:
            task = bars.add_task(label, total=total, note="")
            yield lambda done, total=total, note="": bars.update(task, completed=done, total=total, note=note)
            reached = bars.tasks[0].completed or 1
            bars.update(task, completed=reached, total=reached)

    def log(self, sentence: str) -> None:
        self.console.print(f"  {sentence}", soft_wrap=True, markup=False)  # brackets in data are no markup
