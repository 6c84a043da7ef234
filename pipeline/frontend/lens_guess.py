"""What an unknown lens is guessed to be: the mean of 18 measured colonoscopes, or 100 degrees across the picture.

Both are tried on the film's beginning. Tracking drops what does not fit the lens, and what it keeps fits less well: the
score of a guess is the number of observations that its maps keep, each weighted by 1 - e^2, at least 0, where e px is
the mean reprojection error of its point. Where the scores are close, the mean is taken. The refinement after tracking
then starts near the truth (measured: docs/lab/unknown_lens.md). Where no map begins, the guess by the picture's shape
stays (`calibrate`).
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from haustra.core.camera import Camera, guess_camera
from haustra.core.progress import Progress
from haustra.core.ray_table import RayTable
from haustra.core.threads import single_threaded
from pipeline.config import FAST_KEYFRAME_MOTION, FrontEndSettings
from pipeline.frontend.odometry.frame_io import frame_reader
from pipeline.frontend.odometry.tracking import Odometry
from pipeline.input.endomapper_scopes import colonoscope_across
from pipeline.input.frames import LENS_STAGE, Frames, guessed_by, load_frames
from pipeline.mapping.submap import Submap
from pipeline.mapping.submap_of_map import to_submap
from pipeline.run_folder.stage import load_or_make
from pipeline.run_folder.workspace import Workspace

GUESSES: dict[str, Callable[..., Camera]] = {
    "the mean of 18 colonoscopes": colonoscope_across,
    "100 degrees across": guess_camera,
}
CLOSE = 1.05  # of one score over the other; by judgement, since no film that was measured is so close
MOST_FRAMES = 120
LOOK_EVERY = 20  # frames, after which the two are held against each other
CLEAR_LEAD, LOWEST_SCORE = 2.0, 1500.0  # of the better over the other, at which no more frames are asked


def guess_lens(frames: Frames, settings: FrontEndSettings, workspace: Workspace, progress: Progress) -> Frames:
    """Frames whose lens nobody gave (`guessed_by`), with the guess that fits them better."""
    return load_or_make(
        workspace,
        LENS_STAGE,
        lambda: load_frames(workspace),
        lambda: _choose(frames, settings, workspace, progress),
    )


def _choose(frames: Frames, settings: FrontEndSettings, workspace: Workspace, progress: Progress) -> None:
    scores = scores_of_guesses(frames, settings, workspace, progress)
    result: dict[str, Any] = {"scores": scores}
    first, *others = scores
    # Of two that are close the first: endoscopes are more like the mean of those that were measured.
    best = next((name for name in others if scores[name] > CLOSE * scores[first]), first)
    if scores[best] > 0:
        beaten = " and ".join(f"{score:.0f} with {name}" for name, score in scores.items() if name != best)
        kept = f"the maps of the first frames keep {scores[best]:.0f} observations, weighted by their fit"
        close = min(scores.values()) * CLOSE >= max(scores.values())
        doubt = "; that is close, and does not tell the lens" if close else ""
        result["origin"] = f"guessed: {best}, with which {kept}; {beaten}{doubt}"
        result["camera"] = GUESSES[best](*_size_and_content(frames)).to_dict()
    progress.log(f"camera: {result.get('origin', guessed_by(workspace))}")
    workspace.finish(LENS_STAGE, **result)


def _size_and_content(frames: Frames) -> tuple[int, int, tuple[int, int, int, int]]:
    width, height = frames.camera.width, frames.camera.height
    return width, height, (0, 0, width, height)


def scores_of_guesses(
    frames: Frames, settings: FrontEndSettings, workspace: Workspace, progress: Progress
) -> dict[str, float]:
    """The scores of `GUESSES`, by their names, on the first frames; 0 of one whose maps do not begin."""
    cameras = {name: guess(*_size_and_content(frames)) for name, guess in GUESSES.items()}
    read, index = frame_reader(workspace), frames.index[:MOST_FRAMES].tolist()
    motion = max(settings.odometry.keyframe_motion, FAST_KEYFRAME_MOTION)
    trials = {
        name: Odometry(RayTable(camera), settings.seed, settings.stride, motion) for name, camera in cameras.items()
    }
    scores = dict.fromkeys(trials, 0.0)
    with single_threaded(), progress.bar("lens", len(index)) as advance:
        for done, frame in enumerate(index, start=1):
            rgb, mask = read(frame)
            for odometry in trials.values():
                odometry.process(frame, rgb, odometry.view(rgb, mask))
            advance(done)
            if done % LOOK_EVERY == 0 or done == len(index):
                scores = {name: _score(odometry, cameras[name]) for name, odometry in trials.items()}
                best, second = sorted(scores.values(), reverse=True)
                if best >= max(LOWEST_SCORE, CLEAR_LEAD * second):
                    break
    return scores


def _score(odometry: Odometry, camera: Camera) -> float:
    maps = odometry.maps + ([] if odometry.tracker is None else [odometry.tracker.map])
    found = (to_submap(one, camera.params, refit=False) for one in maps)
    return sum(_agreement(submap) for submap in found if submap is not None)


def _agreement(submap: Submap) -> float:
    """Of each point's observations, by its mean error."""
    views = np.bincount(submap.observations[:, 1], minlength=len(submap.points))
    return float((views * np.maximum(0.0, 1.0 - submap.error_px**2)).sum())
