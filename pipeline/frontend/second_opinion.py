"""The second front end, asked of the stretches of a film that the first one leaves in doubt, within a budget of time.

Each stretch is mapped by itself, the shortest first: what is finished when the time is over counts, and the pace of the
finished ones tells which of the others the time that is left is too short for.
"""

import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import HaustraError
from haustra.core.progress import Progress
from haustra.core.text import counted
from pipeline.frontend.scoring import Candidate, best_mapper, score, sure_of
from pipeline.input.frames import Frames

MIN_STRETCH = 20  # frames in doubt, one after the other, that are worth a second opinion,
MARGIN = 10  # and frames on either side of them that go with them
MOST_FRAMES = 1000  # of all stretches: COLMAP needs half a second a frame and more

ByMapper = dict[str, list[Candidate]]


@dataclass(frozen=True)
class Opinion:
    """What the second front end found of one stretch, by mapper. frames (N,): that it was asked of."""

    frames: NDArray[np.int64]
    candidates: ByMapper


def stretches_in_doubt(candidates: list[Candidate], frames: Frames) -> list[Frames]:
    """Stretches of frames that no sure submap poses, each with some frames around it by which it can be joined, the
    shortest first; those that are too short to be mapped are left out, and the longest, where all are too many."""
    sure = {int(frame) for c in sure_of(candidates, len(frames.index)) for frame in c.submap.frames}
    doubtful = np.array([int(frame) not in sure for frame in frames.index])
    edges = np.flatnonzero(np.diff(doubtful.astype(np.int8), prepend=0, append=0)).reshape(-1, 2)
    found: list[tuple[int, int]] = []
    for begin, end in ((b, e) for b, e in edges if e - b >= MIN_STRETCH):
        wide = max(0, int(begin) - MARGIN), min(int(end) + MARGIN, len(doubtful))
        if found and wide[0] <= found[-1][1]:
            wide = found.pop()[0], wide[1]
        found.append(wide)
    found.sort(key=lambda one: one[1] - one[0])
    few = np.cumsum([end - begin for begin, end in found]) <= MOST_FRAMES
    parts = [(frames.index[b:e], frames.seconds[b:e]) for (b, e), is_few in zip(found, few, strict=True) if is_few]
    return [replace(frames, index=index, seconds=seconds) for index, seconds in parts]


def ask_of_each(
    stretches: list[Frames],
    run: Callable[[Frames], ByMapper],
    deadline: float | None,
    log: Path,
    progress: Progress,
) -> tuple[list[Opinion], str | None]:
    """What the second front end finds of each stretch, in their order, by the deadline (`time.monotonic()`; None: there
    is none), and why it did not find more, if that was an error of its own. Ctrl-C ends it, and keeps what is finished.

    log: folder for the models of stretches that are done while others are mapped.
    """
    opinions: list[Opinion] = []
    pace = 0.0  # s a frame, of the last that was finished
    for number, stretch in enumerate(stretches):
        count, started = len(stretch.index), time.monotonic()
        if pace and deadline is not None and pace * count > deadline - started:
            left = counted(len(stretches) - number, "stretch", "stretches")
            progress.log(f"the time left is too short for {left} of {count} frames and more")
            break
        try:
            found = run(stretch)
        except KeyboardInterrupt:
            progress.log("the comparison was interrupted; going on with what there is")
            break
        except HaustraError as error:
            progress.log(str(error))
            return opinions, str(error)
        if len(stretches) > 1:
            found = {mapper: _moved(of, log / f"stretch_{number}_{mapper}") for mapper, of in found.items()}
        opinions.append(Opinion(stretch.index, found))
        pace = (time.monotonic() - started) / count
    return opinions, None


def joined(first: list[Candidate], opinions: list[Opinion]) -> ByMapper:
    """Maps of the whole film by each mapper of the second front end, most frames first: of the first one those that lie
    outside of what was asked; of each of several stretches the better, where one mapper did not run the other's."""
    parts = [[one for one in first if _share_in(one, opinion.frames) >= 0.5] for opinion in opinions]
    asked = [one for part in parts for one in part]
    kept = [one for one in first if not any(one is other for other in asked)]
    found: ByMapper = {}
    for mapper in dict.fromkeys(mapper for opinion in opinions for mapper in opinion.candidates):
        maps = list(kept)
        for part, opinion in zip(parts, opinions, strict=True):
            count, by_mapper = len(opinion.frames), opinion.candidates
            second = by_mapper[mapper if mapper in by_mapper else best_mapper(by_mapper, count)]
            is_worse = len(opinions) > 1 and score(part, count) >= score(second, count)
            maps += part if is_worse else second
        found[mapper] = sorted(maps, key=lambda one: -one.check.frames)
    return found


def _share_in(candidate: Candidate, frames: NDArray[np.int64]) -> float:
    """Of a submap's frames."""
    return float(np.isin(candidate.submap.frames, frames).mean())


def _moved(candidates: list[Candidate], target: Path) -> list[Candidate]:
    """The same with their models where the next stretch does not overwrite them."""
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    return [
        replace(one, folder=Path(shutil.move(one.folder, target / str(number))))
        for number, one in enumerate(candidates)
    ]
