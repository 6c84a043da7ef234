"""Scoring of front ends' submaps: which are better, and when another front end is run.

A lighting check speaks for or against each submap (`mapping.lighting_check`): the number of posed frames and the
reprojection error do not tell a false two-view start.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera
from pipeline.frontend.base import MIN_FRAMES, FoundSubmap, disjoint
from pipeline.input.frames import read_image
from pipeline.mapping.colmap_io import write_model
from pipeline.mapping.lighting_check import LightingCheck, check_lighting
from pipeline.mapping.submap import Submap
from pipeline.run_folder.workspace import Workspace

MIN_LARGEST = 0.5  # of the frames in the largest submap: a video in smaller pieces is worth another opinion
MIN_POSED = 0.8  # share of frames below which another mapper is asked
MAX_INCONSISTENT = 0.05  # share of frames with brightness growing with distance that is tolerated


@dataclass(frozen=True)
class Candidate:
    """A submap that a mapper found, its lighting check, and the folder of its COLMAP model."""

    submap: Submap
    check: LightingCheck
    folder: Path


def candidates_of(mapper: str, found: list[FoundSubmap], camera: Camera, workspace: Workspace) -> list[Candidate]:
    """The submaps of one mapper without frames in common, most frames first, each checked and written."""
    ordered = sorted(found, key=lambda one: -len(one.submap.frames))
    images, candidates = _image_reader(workspace), []
    for number, (one, submap) in enumerate(zip(ordered, disjoint(o.submap for o in ordered), strict=True)):
        if len(submap.frames) < MIN_FRAMES:
            continue
        folder = one.model or workspace.log / mapper / str(number)
        if one.model is None:
            write_model(submap, camera, folder)
        candidates.append(Candidate(submap, check_lighting(submap, images), folder))
    return candidates


def needs_second_opinion(candidates: list[Candidate], total: int) -> bool:
    """Whether few of the `total` frames are posed, most of them in pieces, no frame has enough points for the lighting
    check, or too many frames fail it."""
    if max((c.check.frames for c in candidates), default=0) < MIN_LARGEST * total:
        return True
    unchecked = not any(c.check.n_checked for c in candidates)
    posed = sum(c.check.frames for c in candidates)
    return posed < MIN_POSED * total or unchecked or inconsistent_share(candidates) > MAX_INCONSISTENT


def accepted(candidates: list[Candidate]) -> list[Candidate]:
    """The largest submap, and of the others those that pass the lighting check."""
    return candidates[:1] + [c for c in candidates[1:] if c.check.inconsistent_share <= MAX_INCONSISTENT]


def best_mapper(candidates: dict[str, list[Candidate]], total: int) -> str:
    """The mapper with the best score over `total` frames; the one asked first where two are alike."""
    return max(candidates, key=lambda mapper: score(candidates[mapper], total))


def score(candidates: list[Candidate], total: int) -> float:
    """Higher is better: how much of the video hangs together, less what fails the lighting check, which weighs five
    times.

    Pieces count by the square of their share, so that one whole map beats two halves. Between mappers that pose the
    same frames, the lighting's rank correlation and the reprojection error of the largest submap decide.
    """
    if not candidates:
        return -np.inf
    first = candidates[0].check
    whole = sum((c.check.frames / total) ** 2 for c in candidates)
    return whole - 5 * inconsistent_share(candidates) - 0.2 * (1 + first.spearman) - 0.02 * first.reprojection_px


def inconsistent_share(candidates: list[Candidate]) -> float:
    """Share of the checked frames of all submaps that fail the lighting check."""
    checked = sum(c.check.n_checked for c in candidates)
    return sum(c.check.inconsistent_share * c.check.n_checked for c in candidates) / max(checked, 1)


def _image_reader(workspace: Workspace) -> Callable[[int], NDArray[np.uint8]]:
    return lambda index: read_image(workspace.image_path(index))
