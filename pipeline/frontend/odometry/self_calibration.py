"""Self-calibration of a guessed lens by bundle adjustment: focal length and radial terms, with standard deviations.

Tracking needs no more than a guess: a focal length that is a sixth off bends the map smoothly. Once the map is there,
one bundle adjustment with the lens free finds it, if the camera moved enough; where it did not, the guess stays.

A wall that moves drives the lens away by far more than its standard deviations say (docs/lab/unknown_lens.md). So a
guess that knows more than an angle across the picture stays where the map that determines another lens is in doubt.
"""

import json
import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from haustra.core.camera import Camera
from haustra.core.errors import HaustraError
from haustra.core.progress import Progress, SilentProgress
from haustra.core.ray_table import ray_table
from pipeline.frontend.base import COLMAP_WORKER, is_determined
from pipeline.frontend.scoring import DOUBTED_FROM, WRONG_OF_UNKNOWN, Candidate, image_reader, with_doubt
from pipeline.mapping.colmap_io import write_model
from pipeline.mapping.final_adjustment import adjust_maps
from pipeline.mapping.lighting_check import check_lighting
from pipeline.mapping.local_map import LocalMap, TrackKind
from pipeline.mapping.map_adjustment import LOSS_PX, adjust_all
from pipeline.mapping.map_doubt import PROBABLE
from pipeline.mapping.submap import Submap
from pipeline.mapping.submap_of_map import submaps_of
from pipeline.matching.sift import FindFeatures
from pipeline.run_folder.subprocesses import run_isolated
from pipeline.run_folder.workspace import Workspace

MOST_FRAMES = 100  # that determine the lens: more cost minutes and add little
FRAME_STEP = 10  # frames between two of them at most; corners are followed over some tens of frames
KEYFRAME_STEP = 3  # the same where the frames are keyframes; their features are found again in four, in the median
MIN_VIEWS = 3  # of a point that takes part; two fit whatever the lens
ROUNDS = 3
MOST_TRIED = 3  # maps; smaller ones hardly determine what the larger ones do not
# Of the width, RMS, by which another lens shifts pixels: above the first the maps are adjusted to their corners again
# before features are asked; below the second the lens has converged.
LENS_RESTART, LENS_CONVERGED = 0.01, 0.001
# Of a lens that was given: frames and points that are asked, and the shift from which on it is doubted: films find
# their own lens within 0.008, and one of a tenth more focal length at 0.03 to 0.04 (docs/guide/calibrate.md).
DOUBT_FRAMES, DOUBT_POINTS, DOUBT_SHIFT = 30, 1500, 0.02
SIGMAS = 4.0  # by which the focal lengths must differ


@dataclass(frozen=True)
class Lens:
    """camera: refined, or the guess where `determined` is False. sigma: of its refined parameters for one pixel of
    noise, focal length first; NaN where nothing determines them."""

    camera: Camera
    sigma: tuple[float, ...]
    determined: bool


def refine_intrinsics(
    maps: list[LocalMap],
    guess: Camera,
    seed: int,
    find: FindFeatures,
    workspace: Workspace,
    progress: Progress,
    changed: bool = False,
) -> tuple[Camera, tuple[float, ...], list[float | None]]:
    """The lens of a film, and all its maps adjusted with it. Returns the lens, its sigmas, and each map's width, as
    `adjust_maps` does, which takes `changed`.

    The largest map that determines a lens gives it for all, since one film has one lens; at most `MOST_TRIED` maps
    are tried, and the guess stays if none of them does. The lens is then refined again with that map as adjusted to
    it, until it converges: what the map had lost for not fitting the guess would have spoken against a better one.
    The other maps wait for it, and are adjusted once.

    A guess with distortion (the mean colonoscope, or an untrusted camera file) gives way only where that map,
    adjusted with the new lens, is wrong with a probability below `DOUBTED_FROM`. Else the guess stays, no other map
    is tried, and in the list `maps` the map as it was adjusted with the guess takes its place again.
    """
    search = _LensSearch(maps, guess, seed, find, workspace, progress, changed)
    by_size = sorted(range(len(maps)), key=lambda n: -len(maps[n].tracked_frames) - len(maps[n].keyframes))
    search.refine(by_size[:MOST_TRIED])
    search.adjust_others()
    return search.camera, search.sigma, [search.widths[number] for number in range(len(maps))]


@dataclass
class _LensSearch:
    """Steps of `refine_intrinsics`, and what they have come to: the lens, and the maps that are adjusted with it.

    widths: of the maps that are adjusted, by number, as of `adjust_maps`. source: number of the map with the lens.
    by_guess: that map as adjusted with the guess, and its width, while the guess may have to come back.
    """

    maps: list[LocalMap]
    guess: Camera
    seed: int
    find: FindFeatures
    workspace: Workspace
    progress: Progress
    changed: bool
    camera: Camera = field(init=False)
    sigma: tuple[float, ...] = ()
    widths: dict[int, float | None] = field(default_factory=dict)
    source: int = 0
    by_guess: tuple[LocalMap, float | None] | None = None

    def __post_init__(self) -> None:
        self.camera = self.guess

    def refine(self, numbers: list[int]) -> None:
        """The lens of the first of these maps that determines one, refined with that map until it converges."""
        wrong = 0.0  # probability, of the map as adjusted with the new lens
        for _ in range(ROUNDS):
            self.source, lens = self._first_determined(numbers)
            if not lens.determined:
                self.sigma = self.sigma or lens.sigma  # an earlier round's answer stands
                break
            numbers, self.sigma = [self.source], lens.sigma
            shift = lens_shift(self.camera, lens.camera)
            if shift < LENS_CONVERGED:
                break
            self.camera = lens.camera
            if any(self.guess.distortion) and self.by_guess is None:
                self.by_guess = self.maps[self.source].copied(), self.widths[self.source]
            self._use_lens(numbers, shift)
            if self.by_guess:
                wrong = _doubt_of(self.maps[self.source], self.camera, self.workspace)
                if wrong >= PROBABLE:
                    break
        if self.by_guess and wrong >= DOUBTED_FROM:
            self._back_to_guess(self.by_guess)
        self.by_guess = None  # a long film's copy is large, and the other maps are still to be adjusted

    def adjust_others(self) -> None:
        """Adjust the maps that gave no lens, with the lens that was found or with the guess."""
        numbers = range(len(self.maps))
        if self.camera == self.guess:
            rest = [n for n in numbers if n not in self.widths]
            self.widths |= _adjusted(self.maps, rest, self.find, self.progress, self.changed)
        else:
            self._use_lens([n for n in numbers if n != self.source], lens_shift(self.guess, self.camera))

    def _first_determined(self, numbers: list[int]) -> tuple[int, Lens]:
        """The first of these maps that determines a lens, and that lens; the very first and its own where none does."""
        lenses: list[Lens] = []
        for number in numbers:
            if number not in self.widths:
                self.widths |= _adjusted(self.maps, [number], self.find, self.progress, self.changed)
            lenses.append(_lens_of(self.maps[number], self.camera, self.seed, self.workspace, self.progress))
            if lenses[-1].determined:
                return number, lenses[-1]
        return numbers[0], lenses[0]

    def _use_lens(self, numbers: list[int], shift: float) -> None:
        """Adjust these maps with the lens as it is now, which lies `shift` (`lens_shift`) from the one they had."""
        far = shift > LENS_RESTART
        self.widths |= _with_lens(self.maps, numbers, self.camera, far, self.find, self.progress)

    def _back_to_guess(self, by_guess: tuple[LocalMap, float | None]) -> None:
        self.progress.log(
            "the lens stays as guessed: the map that determines another is in doubt, or too short to be judged"
        )
        self.maps[self.source], self.widths[self.source] = by_guess
        self.camera, self.sigma = self.guess, (float("nan"),)


def _doubt_of(local_map: LocalMap, camera: Camera, workspace: Workspace) -> float:
    """Probability that a map, adjusted with this lens, is wrong; `WRONG_OF_UNKNOWN` if it is too short to be judged."""
    submaps = submaps_of([local_map], camera.params)
    if not submaps:
        return WRONG_OF_UNKNOWN
    one = Candidate(submaps[0], check_lighting(submaps[0], image_reader(workspace)), Path(), "odometry")
    # How much of the film it holds, and in how many submaps, is no predictor of odometry's family.
    return with_doubt(one, camera, len(one.submap.frames), 1).wrong_probability


def _lens_of(local_map: LocalMap, camera: Camera, seed: int, workspace: Workspace, progress: Progress) -> Lens:
    """The lens that one map determines, by its features, or by its corners where it has none."""
    by_features = submaps_of([local_map], camera.params, kind=TrackKind.FEATURE)
    submaps = by_features or submaps_of([local_map], camera.params)
    if not submaps:
        return Lens(camera, (), False)
    step = KEYFRAME_STEP if by_features else FRAME_STEP
    return refine_lens(submaps[0], camera, seed, workspace.log, progress, step)


def lens_shift(old: Camera, new: Camera) -> float:
    """By how much one lens puts what another sees elsewhere: RMS over the picture, as a share of its width. Where
    either has no ray does not count; infinite if that is everywhere."""
    rays = ray_table(old)
    rows, columns = np.nonzero(rays.usable & ray_table(new).usable)
    if len(rows) == 0:
        return float("inf")
    pixels = np.stack([columns, rows], axis=1)[:: max(1, len(rows) // 5000)] + 0.5
    seen, _ = rays.unproject(pixels)
    off = new.project(np.concatenate([seen, np.ones((len(seen), 1))], axis=1)) - pixels
    return float(np.sqrt((off**2).sum(axis=1).mean()) / old.width)


def _adjusted(
    maps: list[LocalMap], numbers: list[int], find: FindFeatures, progress: Progress, changed: bool
) -> dict[int, float | None]:
    """The last adjustment of some of the maps, by their numbers; of each the width, as of `adjust_maps`."""
    widths = adjust_maps([maps[number] for number in numbers], find, progress, changed)
    return dict(zip(numbers, widths, strict=True))


def _with_lens(
    maps: list[LocalMap], numbers: list[int], camera: Camera, far: bool, find: FindFeatures, progress: Progress
) -> dict[int, float | None]:
    """The same with another lens; with one that is far from the last, adjusted first to the KLT corners alone."""
    rays = ray_table(camera)
    for local_map in (maps[number] for number in numbers):
        local_map.recalibrate(rays)
        if far:
            local_map.forget_features()
            with progress.bar("adjusting to corners", None) as advance:
                adjust_all(local_map, True, advance)
    return _adjusted(maps, numbers, find, progress, changed=True)


def refine_lens(
    submap: Submap, camera: Camera, seed: int, temp_dir: Path, progress: Progress, widest_step: int = FRAME_STEP
) -> Lens:
    """Adjust `submap` with the lens free; the guess comes back if that fails or the motion does not determine it."""
    unknown = Lens(camera, (float("nan"),), False)
    thin = thinned(submap, MOST_FRAMES, widest_step)
    if len(thin.frames) < MIN_VIEWS or len(thin.points) == 0:
        return unknown
    folder = temp_dir / "lens"
    write_model(thin, camera, folder)
    job = {"model": str(folder), "output": str(folder / "lens.json"), "loss_px": LOSS_PX, "seed": seed}
    try:
        run_isolated(COLMAP_WORKER, "calibrate", job, temp_dir / "lens.log", "lens", progress)
    except HaustraError as error:
        progress.log(f"{error}; the guessed lens stays")
        return unknown
    found = json.loads((folder / "lens.json").read_text())
    params, sigma = tuple(map(float, found["params"])), tuple(map(float, found["sigma"]))
    determined = all(map(math.isfinite, params)) and params[0] > 0 and is_determined(params[0], sigma)
    return Lens(replace(camera, params=params) if determined else camera, sigma, determined)


def doubt_of_lens(submap: Submap, given: Camera, seed: int, temp_dir: Path) -> str:
    """One sentence where the film determines a lens that is clearly another than the one given; "" otherwise."""
    few = thinned(submap, DOUBT_FRAMES, KEYFRAME_STEP)
    if len(few.points) > DOUBT_POINTS:
        drop = np.ones(len(few.points), bool)
        drop[np.random.default_rng(seed).permutation(len(few.points))[:DOUBT_POINTS]] = False
        few = few.without_points(drop)
    found = refine_lens(few, replace(given, trusted=False), seed, temp_dir, SilentProgress(), KEYFRAME_STEP)
    if not found.determined:
        return ""
    (focal, *_), (wanted, *_) = found.camera.params, given.params
    shift = lens_shift(given, found.camera)
    if shift < DOUBT_SHIFT or abs(focal - wanted) < SIGMAS * found.sigma[0]:
        return ""
    return (
        f"the lens that was given may be another endoscope's, or of another zoom: its focal length is {wanted:.0f} px, "
        f"and the film's motion says {focal:.0f} px (sigma {found.sigma[0]:.2g} px), which moves what is seen by "
        f"{100 * shift:.1f} % of the width"
    )


def thinned(submap: Submap, most: int, widest_step: int = FRAME_STEP) -> Submap:
    """At most so many of its frames and the points that enough of them see.

    Spread evenly over the submap, or, where that would part them farther than their common points reach, over the
    stretch of it in which the camera turns most: turning is what tells a focal length.
    """
    count, reach = len(submap.frames), most * widest_step
    first = _liveliest(submap, reach) if count > reach else 0
    rows = np.unique(np.linspace(first, min(first + reach, count) - 1, most).round().astype(int))
    dropped = np.setdiff1d(np.arange(count), rows)
    few = submap.without_frames(set(submap.frames[dropped].tolist()))
    return few.without_points(few.track_lengths() < MIN_VIEWS)


def _liveliest(submap: Submap, length: int) -> int:
    """First row of the stretch of that length with the most turning, from frame to frame added up."""
    turns = submap.world_from_camera[:, :3, :3]
    cosine = (np.einsum("nij,nij->n", turns[1:], turns[:-1]) - 1) / 2
    turned = np.concatenate([[0], np.cumsum(np.arccos(np.clip(cosine, -1, 1)))])
    starts = np.append(np.arange(0, len(turns) - length, max(1, length // 2)), len(turns) - length)
    return int(starts[np.argmax(turned[starts + length - 1] - turned[starts])])
