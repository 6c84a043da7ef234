"""Stage 2: working frames to submaps of poses and points, by `odometry` or by COLMAP (front end `sfm`).

`auto` asks odometry, and COLMAP where that leaves frames out or the endoscope's own light contradicts it. Of COLMAP's
mappers the global one goes first, as it has no two-view start that could be false; where it leaves doubt too, the
incremental one follows. Evidence decides between all that were asked.
"""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera
from haustra.core.errors import HaustraError
from haustra.core.progress import Progress
from pipeline.config import Config
from pipeline.frontend.odometry.chunks import scratch
from pipeline.frontend.odometry.front_end import track_frames
from pipeline.frontend.odometry.self_calibration import MAX_FOCAL_SIGMA
from pipeline.input.frames import Frames, read_image
from pipeline.mapping.colmap_io import write_model
from pipeline.mapping.lighting_check import Evidence, judge_submap
from pipeline.mapping.submap import Submap, read_submap
from pipeline.run_folder.subprocesses import run_isolated
from pipeline.run_folder.workspace import Workspace, damage_named

WORKER = "pipeline.frontend.colmap.worker"
MIN_SUBMAP = 3  # frames
MIN_WHOLE = 0.5  # of the frames in the largest model: a video in smaller pieces is worth another opinion
MOST_SFM_FRAMES = 1000  # COLMAP needs half a second a frame and more; `auto` does not ask it of longer videos
Judged = tuple[Submap, Evidence, Path]


def solve_structure(frames: Frames, config: Config, workspace: Workspace, progress: Progress) -> list[Submap]:
    """Submaps, the largest first, each in units of its own median depth; loads them if this stage is done."""
    if workspace.is_done("structure"):
        return load_structure(workspace)
    mapped = _maps(frames, config, workspace, progress)
    chosen = best_mapper(mapped, len(frames.index))
    models = believed(mapped[chosen], config)
    if not models:
        raise HaustraError(_why_no_model(mapped, len(frames.index), workspace))
    _keep(models, workspace)
    evidence = {method: [e.to_dict() for _, e, _ in found] for method, found in mapped.items()}
    _record(models, chosen, evidence, frames, config, workspace, progress)
    shutil.rmtree(scratch(workspace), ignore_errors=True)
    return load_structure(workspace)


def _maps(frames: Frames, config: Config, workspace: Workspace, progress: Progress) -> dict[str, list[Judged]]:
    """The models of each mapper that was asked: another one where those before it leave doubt."""
    if config.front_end == "sfm":
        return _maps_by_colmap(frames, config, workspace, progress)
    count, mapped = len(frames.index), {"odometry": _map_by_odometry(frames, config, workspace, progress)}
    if config.front_end == "auto" and count <= MOST_SFM_FRAMES and is_doubtful(mapped["odometry"], count, config):
        progress.say("odometry leaves doubt; asking COLMAP")
        mapped |= _maps_by_colmap(frames, config, workspace, progress)
    return mapped


def _maps_by_colmap(
    frames: Frames, config: Config, workspace: Workspace, progress: Progress
) -> dict[str, list[Judged]]:
    """Of the global mapper, and of the incremental one where that leaves doubt; none if matching fails under `auto`."""
    job = colmap_job(frames, config, workspace)
    try:
        run_isolated(WORKER, "match", job, workspace.log / "match.log", "features and matches", progress)
    except HaustraError as error:
        if config.front_end != "auto":
            raise
        progress.say(str(error))
        return {}
    mapped = {"global": map_by_colmap("global", job, workspace, progress)}
    if is_doubtful(mapped["global"], len(frames.index), config):
        mapped["incremental"] = map_by_colmap("incremental", job, workspace, progress)
    return mapped


def _why_no_model(mapped: dict[str, list[Judged]], count: int, workspace: Workspace) -> str:
    by_colmap = [method for method in mapped if method != "odometry"]
    if by_colmap and all((workspace.log / f"{method}.failed").exists() for method in by_colmap):
        return f"COLMAP failed to map the frames; its logs are in {workspace.log}"
    if list(mapped) == ["odometry"]:
        return f"odometry could not begin: too few features, or a camera that does not move ({count} frames tried)"
    return f"no two frames could be related: too few features, or a camera that does not move ({count} frames tried)"


def _map_by_odometry(frames: Frames, config: Config, workspace: Workspace, progress: Progress) -> list[Judged]:
    """Submaps by streaming odometry, judged and written as COLMAP's are."""
    tracked = track_frames(frames, config, workspace, progress)
    joined = f"; {tracked.joins} of {tracked.maps} submaps joined to another" if tracked.maps > 1 else ""
    if tracked.seams is None:
        progress.say(f"odometry at {tracked.frames_per_second:.1f} frames a second{joined}")
    else:
        chunks, closed = tracked.seams.chunks, tracked.seams.closed
        progress.say(f"odometry in {chunks} chunks, {closed} of {chunks - 1} seams closed by common frames{joined}")
    output = workspace.log / "odometry"
    shutil.rmtree(output, ignore_errors=True)
    images, judged = _image_reader(workspace), []
    # Chunks pose their common frames twice; where a seam stays open, the larger submap has them.
    submaps = [submap for submap in disjoint(tracked.submaps) if len(submap.frames) >= MIN_SUBMAP]
    for number, submap in enumerate(submaps):
        write_model(submap, frames.camera, output / str(number))
        judged.append((submap, judge_submap(submap, images), output / str(number)))
    return judged


def _record(
    models: list[Judged],
    mapper: str,
    evidence: dict[str, list[dict[str, float]]],
    frames: Frames,
    config: Config,
    workspace: Workspace,
    progress: Progress,
) -> None:
    """Enter the finished stage and tell of it."""
    warnings = _warnings(models, config)
    units = [_unit(submap) for submap, _, _ in models]
    workspace.finish("structure", mapper=mapper, evidence=evidence, units=units, warnings=warnings)
    for sentence in (_sentence(models, mapper, len(frames.index)), *warnings):
        progress.say(sentence)
    if not frames.camera.trusted:
        progress.say(camera_trust(frames.camera, models[0][0]))


def load_structure(workspace: Workspace) -> list[Submap]:
    """The submaps of a finished stage, scaled to units of median depth."""
    units = workspace.result("structure")["units"]
    with damage_named(workspace.models):
        read = [read_submap(workspace.models / str(k)) for k in range(len(units))]
    return [submap.scaled(1 / unit) for submap, unit in zip(disjoint(read), units, strict=True)]


def disjoint(submaps: list[Submap]) -> list[Submap]:
    """Each frame to the first submap that has it: a mapper may pose one frame in several models, but a frame has one
    depth map."""
    claimed: set[int] = set()
    parts = []
    for submap in submaps:
        parts.append(submap.without_frames(claimed))
        claimed |= set(submap.frames.tolist())
    return parts


def structure_camera(camera: Camera, submap: Submap) -> Camera:
    """The camera with the parameters that were refined together with the submap."""
    return Camera(camera.model, camera.width, camera.height, submap.camera_params, camera.trusted)


def camera_trust(guess: Camera, submap: Submap) -> str:
    """What became of a guessed camera, and how far to believe it."""
    focal, start = submap.camera_params[0], guess.focal[0]
    sigma = submap.camera_sigma[0] if submap.camera_sigma else float("nan")
    text = f"camera: focal length {start:.1f} px guessed, {focal:.1f} px after adjustment"
    if focal == start:
        text = f"camera: focal length {start:.1f} px guessed and kept"
    if not np.isfinite(sigma):
        return text + "; the motion does not determine it: shapes may be stretched along the view"
    text += f" (sigma {sigma:.2g} px for 1 px of noise)"
    if sigma > MAX_FOCAL_SIGMA * focal:
        return text + "; too uncertain to trust: shapes may be stretched along the view"
    return text


def colmap_job(frames: Frames, config: Config, workspace: Workspace) -> dict[str, object]:
    """What COLMAP's worker must know of the run."""
    settings = config.structure
    return {
        "database": str(workspace.features),
        "image_folder": str(workspace.images),
        "images": [workspace.image_path(int(index)).name for index in frames.index],
        "masks": str(workspace.masks),
        "scratch": str(workspace.log),
        "camera": frames.camera.to_dict(),
        "refine_camera": not frames.camera.trusted,
        "seed": config.seed,
        **settings.model_dump(exclude={"min_registered", "max_dark_near"}),
    }


def map_by_colmap(method: str, job: dict[str, object], workspace: Workspace, progress: Progress) -> list[Judged]:
    """All models of one mapper, without frames in common, with their evidence; most frames first.

    A mapper that fails is told of, and what it wrote before is used; the other one may still succeed.
    """
    output = workspace.log / method
    shutil.rmtree(output, ignore_errors=True)
    (workspace.log / f"{method}.failed").unlink(missing_ok=True)
    job = job | {"method": method, "output": str(output)}
    try:
        run_isolated(WORKER, "map", job, workspace.log / f"{method}.log", f"structure ({method})", progress)
    except HaustraError as error:
        progress.say(str(error))
        (workspace.log / f"{method}.failed").write_text(str(error))
    read = [(read_submap(p.parent), p.parent) for p in sorted(output.glob("*/model.npz"))]
    read.sort(key=lambda model: -len(model[0].frames))
    images = _image_reader(workspace)
    parts = zip(disjoint([submap for submap, _ in read]), (folder for _, folder in read), strict=True)
    return [(part, judge_submap(part, images), folder) for part, folder in parts if len(part.frames) >= MIN_SUBMAP]


def _image_reader(workspace: Workspace) -> Callable[[int], NDArray[np.uint8]]:
    return lambda index: read_image(workspace.image_path(index))


def is_doubtful(models: list[Judged], total: int, config: Config) -> bool:
    """Few frames posed, most of them in pieces, no frame with enough points to ask the light, or the light says no."""
    settings = config.structure
    posed = sum(evidence.frames for _, evidence, _ in models)
    if max((evidence.frames for _, evidence, _ in models), default=0) < MIN_WHOLE * total:
        return True
    unasked = not any(evidence.voters for _, evidence, _ in models)
    return posed < settings.min_registered * total or unasked or _contrary(models) > settings.max_dark_near


def believed(models: list[Judged], config: Config) -> list[Judged]:
    """The largest model, and of the others those that the light does not contradict."""
    return models[:1] + [model for model in models[1:] if model[1].contrary <= config.structure.max_dark_near]


def best_mapper(mapped: dict[str, list[Judged]], total: int) -> str:
    """The mapper whose models the evidence likes best, of `total` frames; the one asked first where two are alike."""
    return max(mapped, key=lambda method: _score(mapped[method], total))


def _score(models: list[Judged], total: int) -> float:
    """Higher is better: how much of the video hangs together, less what the light contradicts, which weighs five times.

    Pieces count by the square of their share, so that one whole map beats two halves. Between mappers that pose the
    same frames, the light's agreement and the reprojection error of the largest model decide.
    """
    if not models:
        return -np.inf
    first = models[0][1]
    whole = sum((evidence.frames / total) ** 2 for _, evidence, _ in models)
    return whole - 5 * _contrary(models) - 0.2 * (1 + first.spearman) - 0.02 * first.reprojection_px


def _contrary(models: list[Judged]) -> float:
    """Share of the voting frames of all models whose light contradicts them."""
    voters = sum(evidence.voters for _, evidence, _ in models)
    return sum(evidence.contrary * evidence.voters for _, evidence, _ in models) / max(voters, 1)


def _warnings(models: list[Judged], config: Config) -> list[str]:
    """Sentences on models that are kept although the light does not speak for them."""
    found = []
    for number, (_, evidence, _) in enumerate(models):
        if evidence.voters == 0:
            found.append(f"submap {number} has too few points to ask the light whether it is true")
        elif evidence.contrary > config.structure.max_dark_near:
            share = 100 * evidence.contrary
            found.append(f"submap {number} is not to be trusted: in {share:.0f} % of its frames nearer is not brighter")
    return found


def _keep(models: list[Judged], workspace: Workspace) -> None:
    shutil.rmtree(workspace.models, ignore_errors=True)
    for number, (_, _, folder) in enumerate(models):
        shutil.copytree(folder, workspace.models / str(number))


def _unit(submap: Submap) -> float:
    """Median depth of the observations: the scene unit of a reconstruction without scale."""
    depths = submap.depths()
    positive = depths[depths > 0]
    return float(np.median(positive)) if len(positive) else 1.0


def _sentence(models: list[Judged], mapper: str, total: int) -> str:
    posed = sum(len(submap.frames) for submap, _, _ in models)
    first = models[0][1]
    light = f", light agrees in {100 * (1 - first.contrary):.0f} % of {first.voters} frames" if first.voters else ""
    return (
        f"{posed} of {total} frames posed in {len(models)} submap(s) by the {mapper} mapper: {first.points} points, "
        f"reprojection {first.reprojection_px:.2f} px{light}"
    )
