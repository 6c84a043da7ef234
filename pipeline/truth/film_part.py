"""The part of a film that a run is of: what it was asked for, and what its own film has of it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.input.pose_files.pose_table import FilmFrames
from pipeline.run_folder.workspace import Workspace
from reconstruction.evaluation.reference_surface import ALL_TIMES

Array = NDArray[np.float64]
BEYOND = 0.02  # share of the true poses


@dataclass(frozen=True)
class FilmPart:
    """Seconds `from_s` to before `to_s` of the film; asked: whether a run was asked for less than the whole."""

    from_s: float
    to_s: float
    asked: bool

    @staticmethod
    def of(workspace: Workspace) -> "FilmPart":
        """From the first to the last frame that a run read, posed or not, and half a frame on both sides: a film may
        have been cut before the run, which no option tells. A stride leaves frames out behind the last one, and before
        the first one of a part; they belong to the film."""
        film, (first, last) = FilmFrames.of(workspace), asked_seconds(workspace)
        beyond = (workspace.config.frames.stride - 0.5) * film.interval
        before = beyond if film.index[0] else 0.5 * film.interval
        ends = max(first, float(film.seconds[0]) - before), min(last, float(film.seconds[-1]) + beyond)
        return FilmPart(*ends, (first, last) != ALL_TIMES)

    def holds(self, seconds: Array) -> NDArray[np.bool_]:
        """Which of the times (N,) lie in it."""
        return np.asarray((seconds >= self.from_s) & (seconds < self.to_s))

    def is_less_than(self, seconds: Array) -> bool:
        """Whether a truth with poses at these times (N,) knows of more of the film than the run; not by the few that
        one of a higher rate, or one that was stopped later, has beyond it."""
        return self.asked or float(1 - self.holds(seconds).mean()) > BEYOND


def asked_seconds(workspace: Workspace) -> tuple[float, float]:
    """First second of the film that a run was asked for, and the one before which it was to end."""
    asked = workspace.config.frames
    first, last = ALL_TIMES
    return asked.start_s or first, last if asked.end_s is None else asked.end_s


def cut_note(part: FilmPart, seconds: Array) -> tuple[str, ...]:
    """A sentence where a true wall that is known by its frames, at these times (N,), is cut to the part."""
    kept = int(part.holds(seconds).sum())
    if kept == len(seconds):
        return ()
    part_of_film = "the part of the film that the run is of"
    return (f"the wall is cut to what {kept} of the {len(seconds)} true frames saw: {part_of_film}",)
