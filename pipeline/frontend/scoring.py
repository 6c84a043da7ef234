"""Scoring of front ends' submaps: which are better, and when another front end is run.

A lighting check speaks for or against each submap (`mapping.lighting_check`): the number of posed frames and the
reprojection error do not tell a false two-view start.
"""

import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera
from pipeline.frontend.base import FoundSubmap, disjoint
from pipeline.input.frames import Frames, read_image
from pipeline.mapping.colmap_io import write_arrays
from pipeline.mapping.lighting_check import (
    LightingCheck,
    best_stretch,
    check_lighting,
    lighting_correlations,
    summarised,
)
from pipeline.mapping.map_doubt import FAMILY, MapDoubt, coefficients, gather_evidence, judge
from pipeline.mapping.submap import MIN_FRAMES, Submap, refined_camera
from pipeline.mapping.submap_of_map import MIN_SEEN
from pipeline.run_folder.workspace import Workspace

MIN_LARGEST = 0.5  # of the frames in the largest submap: a video in smaller pieces is worth another opinion
MIN_POSED = 0.8  # share of frames below which another mapper is asked
MIN_KEPT = 0.5  # share of a submap's frames that must agree with the light for that part of it to be kept
MIN_SURE = 0.1  # share of the frames in a submap that needs no second opinion
# Probability that a map of odometry is wrong from which COLMAP is asked: of those with 20 to 50 % two in five were
# wrong, of COLMAP's maps of the same kind of films one in seven (docs/lab/map_doubt.md, films for choosing).
DOUBTED_FROM = 0.2
WRONG_OF_UNKNOWN = 0.3  # of the films on which `map_doubt` was fitted
MIN_JUDGED = 20  # frames that the maps had at the fewest on which `map_doubt` was fitted
MAX_POINT_ERROR_PX = 10.0  # mean reprojection error; a mapper that lost its lens has left points off by any amount
MAX_INCONSISTENT = 0.05  # share of frames with brightness growing with distance that is tolerated


@dataclass(frozen=True)
class Candidate:
    """A submap that a mapper found, its lighting check, the folder of its model, and how far it is to be doubted.

    doubt: None of a mapper of which the probability is not known, or of a map too short for it (`with_doubts`).
    unjudged_probability: the probability that it is wrong where it has no doubt of its own: as of the film's others."""

    submap: Submap
    check: LightingCheck
    folder: Path
    mapper: str
    doubt: MapDoubt | None = None
    unjudged_probability: float = WRONG_OF_UNKNOWN

    @property
    def wrong_probability(self) -> float:
        """Probability that the submap is wrong."""
        return self.unjudged_probability if self.doubt is None else self.doubt.probability


def candidates_of(mapper: str, found: list[FoundSubmap], workspace: Workspace) -> list[Candidate]:
    """The submaps of one mapper without frames in common, most frames first, each checked and written.

    Of a submap that the light contradicts, ends that mostly contradict it are cut off, if more is left than that.
    """
    ordered = sorted(found, key=lambda one: -len(one.submap.frames))
    images, candidates = image_reader(workspace), []
    for number, (one, found_submap) in enumerate(zip(ordered, disjoint(o.submap for o in ordered), strict=True)):
        submap = without_wild_points(found_submap)
        if _sees_enough(submap).sum() < MIN_FRAMES:
            continue
        correlations = lighting_correlations(submap, images)
        check, model = summarised(submap, correlations), one.model if submap is found_submap else None
        if check.inconsistent_share > MAX_INCONSISTENT:
            begin, end = best_stretch(correlations)
            if MIN_KEPT * len(submap.frames) <= end - begin < len(submap.frames):
                submap = _only(submap, submap.frames[begin:end])
                check, model = summarised(submap, correlations[begin:end]), None
        # COLMAP's own models, which are numbered too, stay as they are.
        folder = model or _written(submap, workspace.log / mapper / f"{number}_written")
        candidates.append(Candidate(submap, check, folder, mapper))
    return candidates


def part_of(
    one: Candidate, frames: NDArray[np.int64], image_of: Callable[[int], NDArray[np.uint8]]
) -> Candidate | None:
    """Its part of these frames (N,), which it poses, as a submap of its own, checked and written: as probably wrong as
    the whole. None where fewer than `MIN_JUDGED` of them see enough points."""
    if len(frames) == len(one.submap.frames):
        return one
    part = _only(one.submap, frames)
    part = _only(part, part.frames[_sees_enough(part)])
    if len(part.frames) < MIN_JUDGED:
        return None
    folder = _written(part, one.folder.with_name(f"{one.folder.name}_part"))
    return replace(one, submap=part, check=check_lighting(part, image_of), folder=folder)


def _only(submap: Submap, frames: NDArray[np.int64]) -> Submap:
    """These frames of a submap, and the points that two of them see."""
    few = submap.without_frames(set(np.setdiff1d(submap.frames, frames).tolist()))
    return few.without_points(few.track_lengths() < 2)


def _written(submap: Submap, folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)  # of an earlier version, which wrote text beside the arrays
    write_arrays(submap, folder)
    return folder


def without_wild_points(submap: Submap) -> Submap:
    """The same submap where all its points lie near their pixels; else without those that do not, and without frames
    that then see too few."""
    wild = ~(submap.error_px < MAX_POINT_ERROR_PX)  # also what is not a number
    if not wild.any():
        return submap
    rest = submap.without_points(wild)
    return _only(rest, rest.frames[_sees_enough(rest)])


def _sees_enough(submap: Submap) -> NDArray[np.bool_]:
    """(N,) of its frames: whether it sees enough points to be posed by them."""
    return np.bincount(submap.observations[:, 0], minlength=len(submap.frames)) >= MIN_SEEN


def needs_second_opinion(candidates: list[Candidate], total: int) -> bool:
    """Whether submaps that are hardly in doubt pose few of the `total` frames, or most of them in pieces; no frame has
    enough points for the lighting check, or too many frames fail it."""
    likely = [c for c in candidates if c.doubt is None or c.wrong_probability < DOUBTED_FROM]
    if max((c.check.frames for c in likely), default=0) < MIN_LARGEST * total:
        return True
    unchecked = not any(c.check.n_checked for c in candidates)
    posed = sum(c.check.frames for c in likely)
    return posed < MIN_POSED * total or unchecked or inconsistent_share(candidates) > MAX_INCONSISTENT


def sure_of(candidates: list[Candidate], total: int, doubted_from: float = DOUBTED_FROM) -> list[Candidate]:
    """Submaps that need no second opinion: long enough, wrong with a probability below `doubted_from`, and the lighting
    check speaks for them."""
    return [
        c
        for c in candidates
        if c.check.frames >= MIN_SURE * total
        and (c.doubt is None or c.wrong_probability < doubted_from)
        and c.check.n_checked
        and c.check.inconsistent_share <= MAX_INCONSISTENT
    ]


def accepted(candidates: list[Candidate]) -> list[Candidate]:
    """The largest submap, and of the others all but those that the light contradicts and that have no probability of
    being wrong: where there is one, the user is told."""
    return [
        one
        for number, one in enumerate(candidates)
        if number == 0 or one.check.inconsistent_share <= MAX_INCONSISTENT or one.doubt is not None
    ]


def uncovered(kept: list[Candidate]) -> list[Candidate]:
    """Submaps that have `MIN_FRAMES` frames or more which none before them has: a frame belongs to the first."""
    parts = disjoint(one.submap for one in kept)
    return [one for one, part in zip(kept, parts, strict=True) if len(part.frames) >= MIN_FRAMES]


def frames_posed(candidates: list[Candidate]) -> int:
    """Number of frames that any of the submaps poses."""
    return len({int(frame) for one in candidates for frame in one.submap.frames})


def with_doubts(found: list[Candidate], frames: Frames, of_others: float | None = None) -> list[Candidate]:
    """Each submap with its doubt, as of `with_doubt`. One that cannot be judged is as probably wrong as those of its
    mapper that can: maps of one film are alike (docs/lab/map_doubt.md). of_others: where none of them can be judged."""
    judged = [with_doubt(one, frames.camera, len(frames.index), len(found)) for one in found]
    mean = mean_doubt(judged)
    unjudged = of_others if mean is None else mean
    if unjudged is None:
        return judged
    return [one if one.doubt is not None else replace(one, unjudged_probability=unjudged) for one in judged]


def mean_doubt(candidates: list[Candidate]) -> float | None:
    """Probability that a frame of the submaps that could be judged lies in a wrong one; None where there is none."""
    judged = [one for one in candidates if one.doubt is not None]
    frames = sum(one.check.frames for one in judged)
    return sum(one.wrong_probability * one.check.frames for one in judged) / frames if frames else None


def with_doubt(one: Candidate, camera: Camera, total: int, submaps: int) -> Candidate:
    """One of `submaps` of `total` frames with its doubt; without one where it is of a mapper of which the probability
    is not known, or too short for it. camera: before it was refined."""
    family, known = FAMILY.get(one.mapper, ""), coefficients()
    if family not in known or len(one.submap.frames) < MIN_JUDGED:
        return one
    refined, predictors = refined_camera(camera, one.submap), known[family]["weights"]
    evidence = gather_evidence(one.submap, refined, one.check, total, submaps, predictors=predictors)
    return replace(one, doubt=judge(evidence, family))


def best_mapper(candidates: dict[str, list[Candidate]], total: int) -> str:
    """The mapper with the best score over `total` frames; the one asked first where two are alike."""
    return max(candidates, key=lambda mapper: score(candidates[mapper], total))


def score(candidates: list[Candidate], total: int) -> float:
    """Higher is better: how much of the video hangs together, less what fails the lighting check, which weighs five
    times.

    Pieces count by the square of their share, so that one whole map beats two halves, and by the probability that they
    are right. Between mappers that pose the same frames, the lighting's rank correlation and the
    reprojection error of the largest submap decide.
    """
    if not candidates:
        return -np.inf
    first = candidates[0].check
    whole = sum((1 - c.wrong_probability) * (c.check.frames / total) ** 2 for c in candidates)
    return whole - 5 * inconsistent_share(candidates) - 0.2 * (1 + first.spearman) - 0.02 * first.reprojection_px


def inconsistent_share(candidates: list[Candidate]) -> float:
    """Share of the checked frames of all submaps that fail the lighting check."""
    checked = sum(c.check.n_checked for c in candidates)
    return sum(c.check.inconsistent_share * c.check.n_checked for c in candidates) / max(checked, 1)


def image_reader(workspace: Workspace) -> Callable[[int], NDArray[np.uint8]]:
    """Pictures (H,W,3) of the stored working frames, by their number."""
    return lambda index: read_image(workspace.image_path(index))
