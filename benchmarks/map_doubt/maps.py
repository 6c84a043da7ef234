"""Submaps of odometry and of COLMAP on films with truth, under the right lens and wrong ones, kept in a folder between
calls."""

import pickle
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.record import print_row
from haustra.core.camera import Camera, guess_camera
from haustra.core.errors import HaustraError
from haustra.core.progress import SilentProgress
from pipeline.config import FAST_KEYFRAME_MOTION, Config, OdometrySettings
from pipeline.frontend.automatic import FrontEndJob
from pipeline.frontend.base import FoundSubmap
from pipeline.frontend.odometry.frame_io import frame_features
from pipeline.frontend.odometry.front_end import track_frames
from pipeline.frontend.registry import SECOND
from pipeline.frontend.scoring import Candidate, accepted, candidates_of
from pipeline.frontend.second_opinion import ByMapper, most_frames, stretches_in_doubt, thinned_to
from pipeline.input.frames import Frames, read_frames, read_image
from pipeline.input.video import Source
from pipeline.mapping.lighting_check import LightingCheck, brightness_of
from pipeline.mapping.submap import Submap, refined_camera
from pipeline.run_folder.creating import create_workspace
from pipeline.run_folder.workspace import Workspace
from reconstruction.evaluation.trajectory_io import read_tum

Array = NDArray[np.float64]
USUAL = OdometrySettings().keyframe_motion


@dataclass(frozen=True)
class Way:
    """How a film is tracked. lens: what the true focal length is multiplied by; None: lens unknown, 100 degrees.
    part: of the film, from and to. every: n-th working frame. by_colmap: by COLMAP, on as many of the frames as it may
    map in its time, and the others posed in its map."""

    seed: int = 0
    motion: float = FAST_KEYFRAME_MOTION
    lens: float | None = 1.0
    part: tuple[float, float] = (0.0, 1.0)
    every: int = 1
    by_colmap: bool = False


USED = {"usual": Way(motion=USUAL), "fast": Way(), "fast, seed 1": Way(1)}
WRONG_LENS = {
    "focal length -15 %": Way(lens=0.85),
    "focal length +15 %": Way(lens=1.15),
    "unknown lens": Way(lens=None),
}
PARTS = {
    **{f"third {k}": Way(2 + k, part=(k / 3, (k + 1) / 3)) for k in range(3)},
    "half 0, every third": Way(5, part=(0.0, 0.6), every=3),
    "half 1, -20 %": Way(6, lens=0.8, part=(0.45, 1.0)),
}
COLMAP = {
    "COLMAP": Way(by_colmap=True),
    "COLMAP, focal length -15 %": Way(1, lens=0.85, by_colmap=True),
    "COLMAP, unknown lens": Way(2, lens=None, by_colmap=True),
    "COLMAP, half 0": Way(3, part=(0.0, 0.55), by_colmap=True),
    "COLMAP, half 1, -20 %": Way(4, lens=0.8, part=(0.45, 1.0), by_colmap=True),
}
# Ways by role of the film. Parts are there to have wrong maps enough for a fit.
FAMILIES = {
    "odometry": {"choosing": USED | WRONG_LENS | PARTS, "reported": USED | WRONG_LENS},
    "colmap": {"choosing": COLMAP, "reported": COLMAP},
}
WAYS = USED | WRONG_LENS | PARTS | COLMAP


@dataclass(frozen=True)
class JudgedMap:
    """A submap as the structure stage would judge it. brightness (M,): of its observations, as the lighting check
    reads it. truth (N,4,4): world_from_camera of its frames, mm. kept: whether the lighting check keeps it. total:
    working frames that were tracked. submaps: how many came of them."""

    submap: Submap
    check: LightingCheck
    camera: Camera
    brightness: Array
    seconds: Array
    truth: Array
    kept: bool
    total: int
    submaps: int


def load_maps(film: Path, way: str, folder: Path) -> list[JudgedMap]:
    """As `make_maps` left them."""
    found: list[JudgedMap] = pickle.loads(_path(film, way, folder).read_bytes())  # noqa: S301 - written by us
    return found


def is_made(film: Path, way: str, folder: Path) -> bool:
    """Whether an earlier call left the maps of a film and way."""
    return _path(film, way, folder).is_file()


def _path(film: Path, way: str, folder: Path) -> Path:
    return folder / f"{film.name}, {way}.pickle"


def make_maps(film: Path, ways: list[str], folder: Path) -> None:
    """Those that `folder` lacks; the film's frames are read once."""
    missing = [way for way in ways if not is_made(film, way, folder)]
    if not missing:
        return
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        config, video = Config(camera=str(film / "camera.json"), front_end="odometry"), film / "video.mp4"
        with create_workspace(Path(scratch) / "run", film, config, False) as workspace:
            source = Source(video if video.is_file() else film)
            frames = read_frames(source, config.camera, config.frames, workspace, SilentProgress())
            truth = read_tum(film / "trajectory.txt")[1]
            for way in missing:
                found = _judged(frames, WAYS[way], truth, workspace)
                _path(film, way, folder).write_bytes(pickle.dumps(found))
                print_row({"film": film.name, "way": way, "frames": [len(one.submap.frames) for one in found]})


def _judged(frames: Frames, way: Way, truth: Array, workspace: Workspace) -> list[JudgedMap]:
    begin, end = (round(share * len(frames.index)) for share in way.part)
    frames = replace(frames.at(slice(begin, end, way.every)), camera=_lens(frames.camera, way))
    try:
        by_mapper = _mapped(frames, way, workspace)
    except HaustraError:
        return []
    return [one for of in by_mapper.values() for one in _maps_of(of, frames, truth, workspace)]


def _maps_of(candidates: list[Candidate], frames: Frames, truth: Array, workspace: Workspace) -> list[JudgedMap]:
    """Of one mapper."""
    kept = {id(one) for one in accepted(candidates)}
    return [
        JudgedMap(
            one.submap,
            one.check,
            refined_camera(frames.camera, one.submap),
            _brightness(one.submap, lambda index: read_image(workspace.image_path(index))),
            frames.seconds_of_numbers(one.submap.frames),
            truth[one.submap.frames],
            id(one) in kept,
            len(frames.index),
            len(candidates),
        )
        for one in candidates
    ]


def _mapped(frames: Frames, way: Way, workspace: Workspace) -> ByMapper:
    keyframes = OdometrySettings() if way.by_colmap else OdometrySettings(keyframe_motion=way.motion)
    settings = Config(seed=way.seed, odometry=keyframes).front_end_settings
    with frame_features(workspace) as features:
        if way.by_colmap:
            workspace.forget_features()
            fit, every = thinned_to(stretches_in_doubt([], frames), most_frames(len(frames.index), 1.0))
            job = FrontEndJob(features, settings, workspace, SilentProgress())
            return job.run(SECOND, frames, every).candidates if fit else {}
        found = track_frames(frames, features, settings, workspace, SilentProgress()).submaps
    return {"odometry": candidates_of("odometry", [FoundSubmap(one) for one in found], workspace)}


def _lens(camera: Camera, way: Way) -> Camera:
    if way.lens is None:
        return guess_camera(camera.width, camera.height, (0, 0, camera.width, camera.height))
    count = camera.lens.focal_lengths
    return replace(camera, params=(*(way.lens * p for p in camera.params[:count]), *camera.params[count:]))


def _brightness(submap: Submap, image_of: Callable[[int], NDArray[np.uint8]]) -> Array:
    order, starts = submap.by_frame()
    values = np.zeros(len(submap.observations))
    for row, index in enumerate(submap.frames):
        mine = order[starts[row] : starts[row + 1]]
        picture = brightness_of(image_of(int(index)))
        height, width = picture.shape
        x, y = np.floor(submap.pixels[mine]).astype(int).T
        values[mine] = picture[y.clip(0, height - 1), x.clip(0, width - 1)]
    return values
