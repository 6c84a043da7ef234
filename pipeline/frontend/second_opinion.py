"""The second front end, asked of the stretches of a film that the first one leaves in doubt, within a budget of time.

Stretches that are too long for the time are mapped by every n-th of their frames, up to a limit beyond which the
longest are not begun. Each is mapped by itself, the shortest first: what is finished when the time is over counts, and
the pace of the finished ones tells for which of the others too little is left. Where nobody knows the lens, all are
mapped at once, since one film has one lens.
"""

import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera
from haustra.core.errors import HaustraError
from haustra.core.progress import Progress
from haustra.core.text import counted
from pipeline.frontend.base import is_determined
from pipeline.frontend.frames_between import every_nth
from pipeline.frontend.scoring import DOUBTED_FROM, Candidate, sure_of
from pipeline.input.frames import Frames
from pipeline.mapping.colmap_io import write_camera_sigma
from pipeline.mapping.submap import refined_camera

MIN_STRETCH = 20  # frames in doubt, one after the other, that are worth a second opinion,
MARGIN = 10  # and frames on either side of them that go with them
SLOWER = 8.0  # times odometry's time a frame that COLMAP takes; usually 3 to 12 (docs/lab/front_end.md, mapper seeds)
FEW_FRAMES, FEW_SECONDS = 120, 90.0  # that COLMAP may always map, and the time for them, however quick odometry was
MOST_FRAMES = 1000  # of all stretches that are mapped
BY_LIGHT_ALONE = 2.0  # no probability
MOST_EVERY = 6  # frames of a stretch of which one is mapped; on two films with moving walls as good as all of them
BETWEEN_S = 0.04  # for each frame between those that are mapped, set aside of the time; 480x480 px on a busy core

ByMapper = dict[str, list[Candidate]]


@dataclass(frozen=True)
class Stretch:
    """frames: with some around it by which it can be joined. doubtful (N,): numbers of those that no sure map poses."""

    frames: Frames
    doubtful: NDArray[np.int64]


@dataclass(frozen=True)
class Opinion:
    """What the second front end found of one stretch, by mapper."""

    stretch: Stretch
    candidates: ByMapper


def stretches_in_doubt(
    candidates: list[Candidate], frames: Frames, doubted_from: float = DOUBTED_FROM
) -> list[Stretch]:
    """Stretches of frames that no sure submap poses, the shortest first; those that are too short to be mapped are left
    out. doubted_from: the probability that a submap is wrong from which it is not sure."""
    sure = {int(frame) for c in sure_of(candidates, len(frames.index), doubted_from) for frame in c.submap.frames}
    doubtful = np.array([int(frame) not in sure for frame in frames.index])
    spans: list[tuple[int, int]] = []
    for begin, end in runs_of(doubtful, MIN_STRETCH):
        wide = max(0, begin - MARGIN), min(end + MARGIN, len(doubtful))
        if spans and wide[0] <= spans[-1][1]:
            wide = spans.pop()[0], wide[1]
        spans.append(wide)
    spans.sort(key=lambda span: span[1] - span[0])
    rows = [np.arange(*span) for span in spans]
    return [Stretch(frames.at(r), frames.index[r[doubtful[r]]]) for r in rows]


def runs_of(mask: NDArray[np.bool_], least: int) -> list[tuple[int, int]]:
    """First place, and the one after the last, of at least so many that are true one after the other."""
    edges = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0)).reshape(-1, 2)
    return [(int(begin), int(end)) for begin, end in edges if end - begin >= least]


def thinned_to(stretches: list[Stretch], most: float) -> tuple[list[Stretch], int]:
    """Of the stretches, the shortest first, those that can be mapped by at most `most` frames, and of how many frames
    one is mapped for that: 1, if all of all can be."""
    for every in range(1, MOST_EVERY + 1):
        mapped = np.cumsum([len(every_nth(one.frames, every).index) for one in stretches])
        if every == MOST_EVERY or (mapped <= most).all():
            break
    return [one for one, few in zip(stretches, mapped <= most, strict=True) if few], every


def stretches_to_ask(
    candidates: list[Candidate], frames: Frames, most: float
) -> tuple[list[Stretch], int, list[Stretch]]:
    """Stretches that can be mapped by at most `most` frames, of how many frames one is mapped for that, and those left
    out. Where not all in doubt fit, submaps that the lighting check does not contradict may have to stay, so that more
    of the other frames are asked about."""
    choices = []
    for doubted_from in (DOUBTED_FROM, BY_LIGHT_ALONE):
        in_doubt = stretches_in_doubt(candidates, frames, doubted_from)
        fit, every = thinned_to(in_doubt, most)
        left_out = [one for one in in_doubt if not any(one is other for other in fit)]
        choices.append((fit, every, left_out))
        if not left_out:
            break
    doubtful = [sum(len(one.doubtful) for one in fit) for fit, _, _ in choices]
    return choices[int(np.argmax(doubtful))]


def most_frames(total: int, share: float) -> float:
    """Frames that COLMAP can map in `share` times the time that odometry took for a film of `total` frames. By a fixed
    ratio of their speeds and not by the clock, so that the load of a machine changes nothing."""
    return min(MOST_FRAMES, share * max(total / SLOWER, FEW_FRAMES))


def time_allowed(odometry_s: float, share: float) -> float:
    """Seconds that COLMAP may take; odometry_s: those that odometry took."""
    return share * max(odometry_s, FEW_SECONDS)


def at_once(stretches: list[Stretch]) -> list[Stretch]:
    """All of them as one."""
    index = np.concatenate([one.frames.index for one in stretches])
    order = np.argsort(index)
    seconds = np.concatenate([one.frames.seconds for one in stretches])
    doubtful = np.sort(np.concatenate([one.doubtful for one in stretches]))
    return [Stretch(replace(stretches[0].frames, index=index[order], seconds=seconds[order]), doubtful)]


def known_lens(found: list[Candidate], frames: Frames) -> tuple[Camera, tuple[float, ...]] | None:
    """The lens, and its sigmas where it was a guess that the sure maps determine; where the guess knew more than an
    angle across the picture, the one that the first front end's maps have, whether they refined it or not
    (`self_calibration`); None where nobody knows it."""
    if frames.camera.trusted:
        return frames.camera, ()
    for submap in (one.submap for one in sure_of(found, len(frames.index))):
        if is_determined(submap.camera_params[0], submap.camera_sigma):
            return replace(refined_camera(frames.camera, submap), trusted=True), submap.camera_sigma
    if found and any(frames.camera.distortion):
        return replace(refined_camera(frames.camera, found[0].submap), trusted=True), found[0].submap.camera_sigma
    return None


def with_sigma(candidates: list[Candidate], sigma: tuple[float, ...]) -> list[Candidate]:
    """The same, mapped with a lens whose sigmas another map gave; their models say so too."""
    for one in candidates:
        write_camera_sigma(one.folder, sigma)
    return [replace(one, submap=replace(one.submap, camera_sigma=sigma)) for one in candidates]


def ask_of_each(
    stretches: list[Stretch],
    run: Callable[[Frames], ByMapper],
    deadline: float | None,
    log: Path,
    progress: Progress,
) -> tuple[list[Opinion], str | None]:
    """What the second front end finds of each stretch, in their order, by the deadline (`time.monotonic()`; None: there
    is none), and what failed, if anything. Ctrl-C ends it, and keeps what is finished.

    log: folder for the models of stretches that are done while others are mapped.
    """
    opinions: list[Opinion] = []
    failure = None
    pace = 0.0  # s a frame, of the last that was finished
    for number, stretch in enumerate(stretches):
        count, started = len(stretch.frames.index), time.monotonic()
        if number and deadline is not None and pace * count >= deadline - started:
            left = counted(len(stretches) - number, "stretch", "stretches")
            progress.log(f"the time left is too short for {left} of {count} frames and more")
            break
        try:
            found = run(stretch.frames)
        except KeyboardInterrupt:
            progress.log("the comparison was interrupted; going on with what there is")
            break
        except HaustraError as error:
            failure = str(error)
            progress.log(failure)
            continue
        if len(stretches) > 1:
            found = {mapper: _moved(of, log / f"stretch_{number}_{mapper}") for mapper, of in found.items()}
        opinions.append(Opinion(stretch, found))
        pace = (time.monotonic() - started) / count
    return opinions, failure


def _moved(candidates: list[Candidate], target: Path) -> list[Candidate]:
    """The same with their models where the next stretch does not overwrite them."""
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    return [
        replace(one, folder=Path(shutil.move(one.folder, target / str(number))))
        for number, one in enumerate(candidates)
    ]
