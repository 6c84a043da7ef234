"""Stage 2: working frames to submaps of poses and points, by one front end or by the better of two.

What `auto` runs, `automatic.py` says.
"""

import shutil
from pathlib import Path

import numpy as np

from haustra.core.camera import Camera
from haustra.core.errors import HaustraError
from haustra.core.frame_spacing import least_of_each
from haustra.core.progress import Progress
from haustra.core.text import counted
from haustra.core.threads import single_threaded
from pipeline.config import FrontEndSettings
from pipeline.frontend.automatic import FrontEndJob, Result, run_front_ends
from pipeline.frontend.base import disjoint, is_determined
from pipeline.frontend.joined_maps import with_rests
from pipeline.frontend.map_cautions import (
    advice_after,
    advice_unrelated,
    carried_by_depth,
    doubt_of_named_lens,
    doubts_of_submaps,
    few_posed,
)
from pipeline.frontend.registry import FIRST, FRONT_ENDS, SECOND, chosen
from pipeline.frontend.scoring import Candidate, accepted, best_mapper, frames_posed, image_reader, uncovered
from pipeline.input.frames import Frames, write_lens
from pipeline.mapping.feature_triangulation import frames_of_features
from pipeline.mapping.submap import Submap, read_submap, refined_camera
from pipeline.matching.sift_cache import SiftCache
from pipeline.run_folder.stage import load_or_make
from pipeline.run_folder.workspace import Workspace, report_corruption

STAGE = "structure"


def solve_structure(
    frames: Frames,
    features: SiftCache,
    front_end: str,
    settings: FrontEndSettings,
    workspace: Workspace,
    progress: Progress,
) -> list[Submap]:
    """Submaps by `front_end`, a registered name or `auto`; the largest first, each in units of its own median depth."""
    return load_or_make(
        workspace,
        STAGE,
        lambda: load_structure(workspace),
        lambda: _solve(frames, features, chosen(front_end, settings), settings, workspace, progress),
    )


def load_structure(workspace: Workspace) -> list[Submap]:
    """The submaps of a finished stage, scaled to units of median depth."""
    units = workspace.result(STAGE)["units"]
    with report_corruption(workspace.models):
        read = [read_submap(workspace.models / str(k)) for k in range(len(units))]
    return [submap.scaled(1 / unit) for submap, unit in zip(disjoint(read), units, strict=True)]


def front_end_of(workspace: Workspace) -> str:
    """Name of the front end whose submaps a finished stage kept."""
    record = workspace.result(STAGE)
    name = record.get("front_end")  # absent in runs of version 0.1
    return str(name or ("odometry" if record["mapper"] == "odometry" else "sfm"))


def closes_loops(workspace: Workspace) -> bool:
    """Whether the front end of a finished stage closed the loops itself."""
    return FRONT_ENDS[front_end_of(workspace)].closes_loops


def scene_unit(workspace: Workspace) -> float:
    """How much one scene unit of the first submap is in the unit in which its front end found it."""
    return scene_units(workspace)[0]


def scene_units(workspace: Workspace) -> list[float]:
    """The same of each submap."""
    return [float(unit) for unit in workspace.result(STAGE)["units"]]


def camera_trust(guess: Camera, submap: Submap, poses_given: bool) -> str:
    """What became of a guessed camera, and how far to trust it."""
    focal, start = submap.camera_params[0], guess.focal[0]
    guessed = f"camera: focal length guessed as {start:.1f} px for working frames {guess.width} px wide"
    if poses_given:
        return (
            f"{guessed}, and not refined, because the poses were given; do not trust shapes and lengths before the "
            "lens is given, too (--camera)"
        )
    sigma = submap.camera_sigma[0] if submap.camera_sigma else float("nan")
    text = f"{guessed}, and kept" if focal == start else f"{guessed}, {focal:.1f} px after adjustment"
    if not np.isfinite(sigma):
        return text + "; no trusted map determines it: shapes may be stretched along the view"
    if sigma > focal:
        return text + "; this film does not determine it at all: shapes may be stretched along the view"
    text += f" (sigma {sigma:.2g} px for 1 px of noise)"
    if not is_determined(focal, submap.camera_sigma):
        return text + "; too uncertain to trust: shapes may be stretched along the view"
    return text


def _solve(
    frames: Frames,
    features: SiftCache,
    front_end: str,
    settings: FrontEndSettings,
    workspace: Workspace,
    progress: Progress,
) -> None:
    results, failure = run_front_ends(FrontEndJob(features, settings, workspace, progress), front_end, frames)
    by_mapper = {mapper: found for result in results.values() for mapper, found in result.candidates.items()}
    total = len(frames.index)
    mapper = best_mapper(by_mapper, total) if by_mapper else ""
    found = by_mapper.get(mapper, [])
    if not found:
        raise HaustraError(_why_nothing(results, failure, frames, workspace))
    name = next(name for name, result in results.items() if mapper in result.candidates)
    with single_threaded():
        kept = uncovered(accepted(found))
        if FIRST in results and mapper not in results[FIRST].candidates:
            kept = with_rests(kept, results[FIRST].maps, image_reader(workspace))
        _begin_features(kept, frames, features, settings)
        _keep(kept, workspace)
        warnings = doubt_of_named_lens(kept[0].submap, frames.camera, settings, workspace)
    _keep_lens(frames.camera, refined_camera(frames.camera, kept[0].submap), workspace)
    warnings += _warnings(kept, results, name, total, settings, workspace)
    workspace.finish(
        STAGE,
        front_end=FIRST if results[name].in_parts else name,  # in parts: loops between two front ends' maps are open
        mapper=mapper,
        evidence={of: [c.check.to_dict() for c in found] for of, found in (by_mapper | {mapper: kept}).items()},
        doubts=[None if one.doubt is None else one.doubt.to_dict() for one in kept],
        units=[_unit(c.submap) for c in kept],
        stats=results[name].stats,
        warnings=warnings,
    )
    for sentence in (_sentence(kept, total), *warnings):
        progress.log(sentence)
    if not frames.camera.trusted:
        progress.log(camera_trust(frames.camera, kept[0].submap, settings.poses.file is not None))


def _why_nothing(results: dict[str, Result], failure: str | None, frames: Frames, workspace: Workspace) -> str:
    """One sentence on a film of which no front end made a submap. failure: why the second one failed, if it did."""
    tried = [*results, *([] if failure is None else [SECOND])]
    why = (
        f"no two frames could be related: too few features that they share, or too little motion of the camera "
        f"({len(frames.index)} frames tried by {', '.join(results)}); "
        f"{advice_unrelated(tried, frames.camera, workspace)}"
    )
    return why if failure is None else f"{why}; {SECOND} failed as well: {failure}"


def _warnings(
    kept: list[Candidate],
    results: dict[str, Result],
    name: str,
    total: int,
    settings: FrontEndSettings,
    workspace: Workspace,
) -> list[str]:
    """Sentences on submaps that are kept, of the front end `name`, and those of all front ends that were run."""
    advice = advice_after([of for of, result in results.items() if not result.in_parts], workspace)
    each = "" if settings.poses.file is None else f"check that {settings.poses.file} has a pose for each frame, "
    return [
        *few_posed(frames_posed(kept), total, each + advice),
        *doubts_of_submaps(kept, advice),
        *carried_by_depth(results[name].stats.get("bridged", 0)),
        *(sentence for result in results.values() for sentence in result.warnings),
    ]


def _begin_features(
    candidates: list[Candidate], frames: Frames, features: SiftCache, settings: FrontEndSettings
) -> None:
    """Those that the stage `points` will match: a second processor finds them while the maps are judged."""
    motion_px = settings.odometry.keyframe_motion * frames.camera.width
    submaps = [candidate.submap for candidate in candidates]
    for submap, least in zip(submaps, least_of_each([len(one.frames) for one in submaps]), strict=True):
        for frame in frames_of_features(submap, frames.camera, motion_px, least):
            features.begin(frame)


def _keep_lens(began: Camera, ended: Camera, workspace: Workspace) -> None:
    origin = "given" if began.trusted else "guessed" if ended.params == began.params else "refined by the film"
    write_lens(ended, origin, workspace)


def _keep(candidates: list[Candidate], workspace: Workspace) -> None:
    shutil.rmtree(workspace.models, ignore_errors=True)
    for number, candidate in enumerate(candidates):
        _copy_folder(candidate.folder, workspace.models / str(number))


def _copy_folder(source: Path, target: Path) -> None:
    """As `shutil.copytree`, whose error hides what the file system said: a full disk has a sentence of its own."""
    target.mkdir(parents=True)
    for path in sorted(source.iterdir()):
        if path.is_dir():
            _copy_folder(path, target / path.name)
        else:
            shutil.copyfile(path, target / path.name)


def _unit(submap: Submap) -> float:
    """Median depth of the observations: the scene unit of a reconstruction without scale."""
    depths = submap.depths()
    positive = depths[depths > 0]
    return float(np.median(positive)) if len(positive) else 1.0


def _sentence(candidates: list[Candidate], total: int) -> str:
    posed, first = frames_posed(candidates), candidates[0].check
    mappers = list(dict.fromkeys(one.mapper for one in candidates))
    by = " and ".join(mappers) + (" mapper" if len(mappers) == 1 else " mappers")
    contrary = f"{100 * first.inconsistent_share:.0f} % of {first.n_checked} frames"
    light = f", nearer wall darker, against the lamp's light, in {contrary}" if first.n_checked else ""
    of_first = "" if len(candidates) == 1 else f"the first, of {counted(first.frames, 'frame')}, has "
    return (
        f"{posed} of {total} frames posed in {counted(len(candidates), 'submap')} by the {by}: {of_first}"
        f"{first.points} points, reprojection {first.reprojection_px:.2f} px{light}"
    )
