"""Which front ends are run: the chosen one, or by `auto` odometry, and COLMAP on what odometry leaves in doubt.

In doubt are frames without a pose, submaps that the endoscope's own light contradicts, and those that may well be
wrong by all that is known of them (`mapping/map_doubt.py`).
"""

import time
from dataclasses import dataclass, replace

from haustra.core.progress import Progress
from haustra.core.text import counted
from haustra.core.threads import single_threaded
from pipeline.config import FrontEndSettings
from pipeline.frontend.base import FoundSubmap, disjoint
from pipeline.frontend.frames_between import every_nth, with_frames_between
from pipeline.frontend.joined_maps import joined
from pipeline.frontend.odometry.frame_io import frame_reader
from pipeline.frontend.registry import AUTO, FIRST, FRONT_ENDS, SECOND
from pipeline.frontend.scoring import (
    DOUBTED_FROM,
    Candidate,
    candidates_of,
    mean_doubt,
    needs_second_opinion,
    with_doubts,
    without_wild_points,
)
from pipeline.frontend.second_opinion import (
    BETWEEN_S,
    MOST_EVERY,
    MOST_FRAMES,
    ByMapper,
    ask_of_each,
    at_once,
    known_lens,
    most_frames,
    stretches_to_ask,
    time_allowed,
    with_sigma,
)
from pipeline.input.frames import Frames
from pipeline.mapping.submap import MIN_FRAMES
from pipeline.matching.sift_cache import SiftCache
from pipeline.run_folder.workspace import Workspace


@dataclass(frozen=True)
class Result:
    """What a front end found, checked and written."""

    candidates: ByMapper  # of each mapper, in the order in which they were run
    stats: dict[str, float]
    in_parts: bool = False  # of stretches of the film, with the first front end's submaps of the rest
    warnings: tuple[str, ...] = ()

    @property
    def maps(self) -> list[Candidate]:
        """The submaps of all its mappers."""
        return [one for of in self.candidates.values() for one in of]


@dataclass(frozen=True)
class FrontEndJob:
    """What every front end is given beside the frames, by which it can be run."""

    features: SiftCache
    settings: FrontEndSettings
    workspace: Workspace
    progress: Progress

    def run(self, name: str, frames: Frames, every: int = 1) -> Result:
        """One front end; every: n, of which frames one is mapped, and the others are posed in its submaps."""
        mapped, settings = every_nth(frames, every), self.settings
        if settings.deadline is not None:
            aside = BETWEEN_S * (len(frames.index) - len(mapped.index))
            settings = settings.model_copy(update={"deadline": settings.deadline - aside})
        result = FRONT_ENDS[name].run(mapped, self.features, settings, self.workspace, self.progress)
        found = result.found if every == 1 else {m: self._between(of, frames, every) for m, of in result.found.items()}
        candidates = {m: candidates_of(m, of, self.workspace) for m, of in found.items()}
        return Result(candidates, result.stats, warnings=result.warnings)

    def _between(self, found: list[FoundSubmap], frames: Frames, every: int) -> list[FoundSubmap]:
        read, deadline = frame_reader(self.workspace), self.settings.deadline
        mapped = sorted((one.submap for one in found), key=lambda submap: -len(submap.frames))
        with single_threaded(), self.progress.bar("frames between", None) as advance:
            return [
                FoundSubmap(with_frames_between(without_wild_points(submap), frames, every, read, deadline, advance))
                for submap in disjoint(mapped)
                if len(submap.frames) >= MIN_FRAMES
            ]


def run_front_ends(job: FrontEndJob, front_end: str, frames: Frames) -> tuple[dict[str, Result], str | None]:
    """Results of the chosen front end; under `auto` of a second one where the first one's is doubtful, or why that one
    failed."""
    if front_end != AUTO:
        return {front_end: _doubted(job.run(front_end, frames), frames)}, None
    started = time.monotonic()
    results = {FIRST: _doubted(job.run(FIRST, frames), frames)}
    found = results[FIRST].maps
    if not needs_second_opinion(found, len(frames.index)):
        return results, None
    second, failure = _second_opinion(job, frames, found, time.monotonic() - started)
    return results if second is None else results | {SECOND: second}, failure


def _doubted(result: Result, frames: Frames, of_others: float | None = None) -> Result:
    with single_threaded():
        doubted = {mapper: with_doubts(of, frames, of_others) for mapper, of in result.candidates.items()}
        return replace(result, candidates=doubted)


def _second_opinion(
    job: FrontEndJob, frames: Frames, found: list[Candidate], first_s: float
) -> tuple[Result | None, str | None]:
    """Of the stretches that the first front end, which took `first_s` seconds, leaves in doubt; none where it cannot be
    had, and what failed."""
    total, share, progress = len(frames.index), job.settings.second_opinion, job.progress
    budget = time_allowed(first_s, share) if found else None
    most = MOST_FRAMES if budget is None else most_frames(total, share)
    stretches, every, left_out = stretches_to_ask(found, frames, most)
    if not stretches:
        if most and left_out:
            progress.log(
                f"{_why(found, total)}; {SECOND} (COLMAP) is not run for comparison: even every {MOST_EVERY}th of the "
                f"{len(left_out[0].frames.index)} frames of the shortest stretch in doubt is more than the "
                f"{most:.0f} that it can map in its time (second_opinion {share:g}); --front-end sfm runs it on the "
                "whole film"
            )
        return None, None
    lens = known_lens(found, frames)
    if lens is None:
        stretches = at_once(stretches)
    camera, sigma = lens or (frames.camera, ())
    count = sum(len(one.frames.index) for one in stretches)
    progress.log(
        f"{_why(found, total)}; running {SECOND} (COLMAP) for comparison on {_some(every, count)} of {total} "
        f"frames, in {counted(len(stretches), 'stretch', 'stretches')}"
        + (f" ({counted(len(left_out), 'longer one is', 'longer ones are')} too long)" if left_out else "")
        + ("" if budget is None else f", for {max(budget, 1):.0f} s at most")
        + " (Ctrl-C goes on without it)"
    )
    deadline = None if budget is None else time.monotonic() + budget
    timed_job = replace(job, settings=job.settings.model_copy(update={"deadline": deadline}))

    def ask(some: Frames) -> ByMapper:
        if len(stretches) > 1 or every > 1 or camera != frames.camera:  # features of other frames or by another lens
            job.workspace.forget_features()
        result = timed_job.run(SECOND, replace(some, camera=camera), every)
        by_mapper = _doubted(result, frames, mean_doubt(found)).candidates
        return {mapper: with_sigma(of, sigma) if sigma else of for mapper, of in by_mapper.items()}

    opinions, failure = ask_of_each(stretches, ask, deadline, job.workspace.log, progress)
    by_mapper = joined(found, total, opinions)
    if opinions and not any(by_mapper.values()) and found:
        has_maps = any(maps for one in opinions for maps in one.candidates.values())
        why = f"by what is known of them the maps of {SECOND} are no better" if has_maps else f"{SECOND} found no map"
        progress.log(f"{why}; {'that' if len(found) == 1 else 'those'} of {FIRST} stay{'s' if len(found) == 1 else ''}")
    result = Result(by_mapper, {}, in_parts=count < total) if by_mapper else None
    return result, None if opinions else failure


def _some(every: int, count: int) -> str:
    return str(count) if every == 1 else f"every {every}{ {2: 'nd', 3: 'rd'}.get(every, 'th') } of {count}"


def _why(candidates: list[Candidate], total: int) -> str:
    """Why the first front end's result is not taken as it is."""
    posed = sum(c.check.frames for c in candidates)
    checked = sum(c.check.n_checked for c in candidates)
    failed = sum(c.check.inconsistent_share * c.check.n_checked for c in candidates)
    light = f"in {failed:.0f} of {checked} checked frames brightness grows with distance"
    if checked == 0:
        light = "no frame has enough points for the lighting check"
    wrong = sum(c.check.frames for c in candidates if c.doubt is not None and c.wrong_probability >= DOUBTED_FROM)
    least = f"with a probability of {100 * DOUBTED_FROM:.0f} % or more"
    doubt = f", {wrong} of them in submaps that are wrong {least}" if wrong else ""
    return f"{FIRST} posed {posed} of {total} frames in {counted(len(candidates), 'submap')}{doubt}, and {light}"
