"""Stage 7: trajectories, scaled structure, figures: everything of a run that a person or the next program reads."""

import json
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np

from haustra.core.progress import Progress
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.completion_stage import camera_path
from pipeline.depth.depth_io import DEPTH_STEP
from pipeline.frontend.base import COLMAP_WORKER
from pipeline.frontend.structure_stage import camera_trust, front_end_of
from pipeline.input.frames import Frames, camera_origin
from pipeline.loop_closing.close_loops import first_parts, model_sources
from pipeline.report.cautions import reasons_for_doubt
from pipeline.report.page.page import write_page
from pipeline.report.page.pictures import PagePictures
from pipeline.run_folder.subprocesses import run_isolated
from pipeline.run_folder.workspace import Workspace, write_json
from pipeline.surface.coverage_stage import CoverageResult
from pipeline.surface.fusion_stage import Surface, mesh_path
from pipeline.surface.wall_motion import load_motion, sentences
from reconstruction.evaluation.trajectory_io import write_tum
from reconstruction.mesh.mesh_io import write_mesh


def write_report(
    frames: Frames,
    submaps: list[CompletedSubmap],
    surfaces: list[Surface],
    coverage: list[CoverageResult],
    workspace: Workspace,
    pictures: Callable[[], PagePictures],
    stages: list[dict[str, Any]] | None = None,
) -> None:
    """Write `metrics.json` and `report.html`; pictures: gives those of the page when they are drawn; stages: the
    `StageTime` of those that are done, where they are asked for."""
    workspace.record["submaps"] = [
        _submap_record(camera_path(workspace, part).name, completed, surface)
        for part, completed, surface in zip(first_parts(workspace, len(submaps)), submaps, surfaces, strict=True)
    ]
    metrics = collect_metrics(frames, submaps, surfaces, coverage, workspace)
    if stages is not None:
        metrics["profile"] = stages
    write_json(workspace.metrics, metrics)
    write_page(frames, submaps, surfaces, coverage, metrics, workspace, pictures())
    workspace.finish("report")


def write_geometry(
    frames: Frames,
    submaps: list[CompletedSubmap],
    surfaces: list[Surface],
    workspace: Workspace,
    progress: Progress,
) -> None:
    """Write trajectories, `sparse/` in output units and `mesh.glb`, which need nothing of the coverage."""
    for number, (completed, surface) in enumerate(zip(submaps, surfaces, strict=True)):
        _write_paths(frames, completed, surface, number, workspace)
    _scale_sparse(surfaces, workspace, progress)
    write_mesh(surfaces[0].mesh, workspace.mesh_glb)


def add_profile(workspace: Workspace, stages: list[dict[str, Any]], progress: Progress) -> None:
    """Add each stage's `StageTime` to `metrics.json`, and say them in one sentence each."""
    metrics = json.loads(workspace.metrics.read_text())
    write_json(workspace.metrics, metrics | {"profile": stages})
    for one in stages:
        progress.log(
            f"{one['stage']}: {one['seconds']:.1f} s, {one['cpu_seconds']:.1f} s of processor time; "
            f"peak memory so far {one['peak_mib']:.0f} MiB"
        )


def _submap_record(camera: str, completed: CompletedSubmap, surface: Surface) -> dict[str, Any]:
    """How to read a submap's depth maps: unit, step of the PNGs, camera, and which frames they are."""
    return {
        "unit": surface.scale.unit,
        "depth_png_step": DEPTH_STEP * surface.scale.factor,
        "camera": camera,
        "keyframes": completed.submap.frames[completed.rows].tolist(),
        "depth_scale": None if completed.depth_scale is None else completed.depth_scale[completed.rows].tolist(),
    }


def _write_paths(
    frames: Frames, completed: CompletedSubmap, surface: Surface, number: int, workspace: Workspace
) -> None:
    """`trajectory.tum` and `keyframes.tum`; with `_1`, `_2`, ... for further submaps, each in its own frame."""
    submap = completed.submap.scaled(surface.scale.factor)
    seconds = np.array([frames.seconds_of(int(index)) for index in submap.frames])
    for path, rows in ((workspace.trajectory, np.arange(len(seconds))), (workspace.keyframes, completed.rows)):
        named = path if number == 0 else path.with_name(f"{path.stem}_{number}.tum")
        write_tum(named, seconds[rows], submap.world_from_camera[rows])


def _scale_sparse(surfaces: list[Surface], workspace: Workspace, progress: Progress) -> None:
    """Bring the COLMAP models to output units, from those that the stages before keep in units of their own."""
    models = [
        {"source": str(source), "target": str(workspace.sparse / str(k)), "factor": surface.scale.factor / unit}
        for k, (surface, (source, unit)) in enumerate(zip(surfaces, model_sources(workspace), strict=True))
    ]
    run_isolated(
        COLMAP_WORKER,
        "scale",
        {"models": models},
        workspace.log / "scale.log",
        "sparse models",
        progress,
    )


def collect_metrics(
    frames: Frames,
    submaps: list[CompletedSubmap],
    surfaces: list[Surface],
    coverage: list[CoverageResult],
    workspace: Workspace,
) -> dict[str, Any]:
    """Every figure of the run, with unit and count."""
    structure, poses_given = workspace.result("structure"), workspace.config.poses.file is not None
    refinement = workspace.result("refinement") if workspace.is_done("refinement") else {"submaps": [], "warnings": []}
    # What speaks for a submap that others were joined to is said of its first part.
    first = first_parts(workspace, len(submaps))
    evidence = [structure["evidence"][structure["mapper"]][part] for part in first]
    doubts = structure.get("doubts", [])  # absent in runs of earlier versions
    doubts = [doubts[part] for part in first if doubts]
    records = [
        _submap_metrics(frames, poses_given, *parts)
        for parts in zip(submaps, surfaces, coverage, evidence, strict=False)
    ]
    for number, record in enumerate(records):
        record["doubt"] = doubts[number] if doubts else None
    motion = load_motion(workspace)
    for record, found in zip(records, motion, strict=False):
        record["wall_motion"] = None if found is None else asdict(found)
    return {
        "source": workspace.record["source"]["path"],
        "frames": {
            "total": sum(frames.verdicts.values()),
            "posed": sum(len(completed.submap.frames) for completed in submaps),
            "verdicts": frames.verdicts,
            "notes": workspace.result("frames")["notes"],
        },
        "camera": camera_origin(workspace),
        "front_end": front_end_of(workspace),
        "mapper": structure["mapper"],
        "warnings": reasons_for_doubt(
            [*structure["warnings"], *refinement["warnings"], *sentences(motion)], surfaces, records
        ),
        "loops": refinement["submaps"],
        "model": workspace.record["config"]["model"],
        "submaps": records,
        "meshes": [mesh_path(workspace, number).name for number in range(len(surfaces))],
    }


def _submap_metrics(
    frames: Frames,
    poses_given: bool,
    completed: CompletedSubmap,
    surface: Surface,
    coverage: CoverageResult,
    check: dict[str, Any],
) -> dict[str, Any]:
    """Figures of one submap; `check` is what the structure stage recorded of it."""
    mesh, submap = surface.mesh, completed.submap.scaled(surface.scale.factor)
    steps = np.linalg.norm(np.diff(submap.centres, axis=0), axis=1)
    return {
        "frames": len(submap.frames),
        "keyframes": len(completed),
        "points": len(submap.points),
        "faces": len(mesh.faces),
        "area": float(mesh.face_areas.sum()),
        "path_length": float(steps.sum()),
        "voxel_size": surface.voxel_size,
        "dropped_area_share": surface.dropped_share,
        "opened_area_share": surface.opened_share,
        "contradicted_keyframes": list(surface.left_out),
        "lamp": None if surface.illumination is None else asdict(surface.illumination),
        "unit": surface.scale.unit,
        "coverage": coverage.record,
        "scale": surface.scale.origin,
        "evidence": check,
        "camera": {
            "model": frames.camera.model,
            "params": list(submap.camera_params),
            "sigma": list(submap.camera_sigma),
            "trust": "given" if frames.camera.trusted else camera_trust(frames.camera, submap, poses_given),
        },
        "rectified_share": completed.rectifier.kept_share,
    }
