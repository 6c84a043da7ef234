"""Stage 5: keyframes' dense depth to one surface per submap, in the output unit, with the camera path in it."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import HaustraError
from haustra.core.progress import Progress
from haustra.core.text import counted
from haustra.core.threads import prefetched
from pipeline.config import ConsistencySettings, FusionSettings
from pipeline.depth.completed_submap import CompletedKeyframe, CompletedSubmap
from pipeline.run_folder.resuming import FROM_SURFACE
from pipeline.run_folder.stage import load_or_make
from pipeline.run_folder.workspace import Workspace
from pipeline.surface.depth_filter import DepthFilter
from pipeline.surface.no_surface import why_no_surface
from pipeline.surface.scale import Scale, ScaleSource, find_scale, unit_label
from reconstruction.fusion.dark_spots import dark_spots, without_vertices
from reconstruction.fusion.lamp import Lamp
from reconstruction.fusion.photometry import Illumination, fit_illumination
from reconstruction.fusion.tsdf import SurfaceFusion, TsdfSettings, choose_voxel_size
from reconstruction.mesh.mesh_io import read_mesh, write_mesh
from reconstruction.mesh.surface_mesh import SurfaceMesh, drop_small_components

Array = NDArray[np.float64]

STAGE = "surface"
# Less than a fold is thick, or the depths of its two sides would be averaged; more than the expected error of depth
# that is fused (`max_error_voxels`), or one wall would become two sheets. Chosen by docs/lab/fusion.md.
TRUNCATION_VOXELS = 5.0
MIN_COMPONENT = 0.02  # share of the area; smaller pieces float
VOXEL_SAMPLES = 12  # keyframes from which the voxel size is chosen
ILLUMINATION_SAMPLES = 60  # keyframes to which the illumination's exponents are fitted


@dataclass(frozen=True)
class Surface:
    """A submap's mesh in output units and what became of it."""

    mesh: SurfaceMesh
    scale: Scale
    voxel_size: float  # output units
    dropped_share: float  # of the area, in pieces too small to keep
    left_out: tuple[int, ...] = ()  # frame numbers of keyframes whose depth the others contradict
    illumination: Illumination | None = None  # divided out of the colours; None if they are as filmed
    opened_share: float = 0.0  # of the area, in small spots too dark for their depth, left open


@dataclass(frozen=True)
class SurfaceSettings:
    """Settings of the parts of the stage, the source of the scale, and the seed and lamp of the illumination."""

    fusion: FusionSettings
    consistency: ConsistencySettings
    scale: ScaleSource
    seed: int
    lamp: Lamp | None = None  # measured: its fall-off off the axis; None: that is fitted to the film too


def fuse_depth(
    submaps: list[CompletedSubmap], settings: SurfaceSettings, workspace: Workspace, progress: Progress
) -> list[Surface]:
    """Fuse every submap; a submap whose frames agree on no surface keeps an empty mesh."""
    return load_or_make(
        workspace,
        STAGE,
        lambda: load_surfaces(workspace),
        lambda: _fuse_all(submaps, settings, workspace, progress),
    )


def _fuse_all(
    submaps: list[CompletedSubmap], settings: SurfaceSettings, workspace: Workspace, progress: Progress
) -> None:
    surfaces = []
    for number, submap in enumerate(submaps):
        own = replace(settings, scale=settings.scale.of_submap(number))
        surface = fuse_submap(submap, own, f"fusion of submap {number}", progress)
        if number == 0 and len(surface.mesh.faces) == 0:
            raise HaustraError(why_no_surface(submap, settings.fusion, surface.voxel_size / surface.scale.factor))
        if number == 0:
            workspace.replace_surface()
        write_mesh(surface.mesh, mesh_path(workspace, number))
        surfaces.append(surface)
    workspace.finish(STAGE, surfaces=[_record(surface) for surface in surfaces])
    progress.log(_sentence(surfaces[0]))


def _record(surface: Surface) -> dict[str, Any]:
    return {
        "factor": surface.scale.factor,
        "unit": surface.scale.unit,
        "origin": surface.scale.origin,
        "doubt": surface.scale.doubt,
        "clock_doubt": surface.scale.clock_doubt,
        "voxel_size": surface.voxel_size,
        "dropped_share": surface.dropped_share,
        "left_out": list(surface.left_out),
        "opened_share": surface.opened_share,
        "lamp": None if surface.illumination is None else asdict(surface.illumination),
    }


def load_surfaces(workspace: Workspace) -> list[Surface]:
    """The surfaces of a finished stage."""
    return [
        Surface(
            read_mesh(mesh_path(workspace, number)),
            Scale(
                *(record[name] for name in ("factor", "unit", "origin")),
                *(record.get(name, "") for name in ("doubt", "clock_doubt")),
            ),
            record["voxel_size"],
            record["dropped_share"],
            tuple(record.get("left_out", ())),
            _recorded_illumination(record["lamp"]) if record.get("lamp") else None,
            record.get("opened_share", 0.0),
        )
        for number, record in enumerate(workspace.result(STAGE)["surfaces"])
    ]


def _recorded_illumination(values: dict[str, Any]) -> Illumination:
    """An illumination from its entry `lamp` in run.yaml; that entry's own `lamp` is absent in older runs."""
    measured = values.get("lamp")
    return Illumination(**values | {"lamp": measured and Lamp(**measured | {"axis": tuple(measured["axis"])})})


def forget_lost_surfaces(workspace: Workspace) -> None:
    """Of a run that is gone on with: where a mesh is missing or damaged, the stage is no longer done, nor what follows
    it, and `made_anew` says so. All that the surface is made of is still there."""
    if not workspace.is_done(STAGE):
        return
    try:
        load_surfaces(workspace)
    except HaustraError as error:
        workspace.made_anew = workspace.made_anew or str(error)
        workspace.undo(FROM_SURFACE)
        workspace.save()


def mesh_path(workspace: Workspace, number: int) -> Path:
    """`mesh.ply` for the first submap, `mesh_1.ply` and on for those that could not be joined to it."""
    return workspace.mesh if number == 0 else workspace.mesh.with_name(f"mesh_{number}.ply")


def fuse_submap(completed: CompletedSubmap, settings: SurfaceSettings, label: str, progress: Progress) -> Surface:
    """One submap's surface in output units; an empty mesh where no keyframe has depth. label: of the progress bar."""
    ranges = fusion_ranges(completed, settings.fusion)
    if ranges is None:
        empty = SurfaceMesh.from_triangles([], [])
        return Surface(empty, find_scale(settings.scale, completed.submap, empty), 0.0, 0.0)
    fusion, left_out = SurfaceFusion(ranges), []
    check = depth_filter(completed, settings.consistency, settings.fusion, ranges)
    illumination = _fitted_illumination(completed, settings) if settings.fusion.delight else None

    def prepared(place: int) -> CompletedKeyframe | int:
        keyframe = completed.keyframe(int(completed.rows[place]))
        return _prepared(keyframe, place, check, illumination, completed.camera.matrix)

    with progress.bar(label, len(completed)) as advance:
        for done, keyframe in enumerate(prefetched(prepared, range(len(completed))), start=1):
            if isinstance(keyframe, int):
                left_out.append(keyframe)
            else:
                images = keyframe.rgb, keyframe.depth, keyframe.confidence
                fusion.integrate(*images, completed.camera.matrix, keyframe.world_from_camera)
            advance(done)
    whole = fusion.extract()
    del fusion  # its voxels are most of the memory
    opened = _without_lids(whole, illumination, ranges.voxel_size) if settings.fusion.open_dark_spots else whole
    mesh, dropped = drop_small_components(opened, MIN_COMPONENT)
    scale = find_scale(settings.scale, completed.submap, mesh)
    output_from_scene = np.diag([scale.factor] * 3 + [1.0])
    area, remaining = (float(part.face_areas.sum()) for part in (whole, opened))
    dropped_share, opened_share = (part / max(area, 1e-12) for part in (dropped.area, area - remaining))
    moved, voxel_size = mesh.transformed(output_from_scene), ranges.voxel_size * scale.factor
    return Surface(moved, scale, voxel_size, dropped_share, tuple(left_out), illumination, opened_share)


def _without_lids(mesh: SurfaceMesh, illumination: Illumination | None, voxel_size: float) -> SurfaceMesh:
    """The mesh without spots too dark for their depth; as it is where the colours are as filmed or none is found."""
    if illumination is None:
        return mesh
    spots = dark_spots(mesh, voxel_size, illumination.gamma)
    return without_vertices(mesh, spots) if spots.any() else mesh


def _prepared(
    keyframe: CompletedKeyframe, place: int, check: DepthFilter, illumination: Illumination | None, intrinsics: Array
) -> CompletedKeyframe | int:
    """The keyframe at a place among the submap's, with the confidence that is fused and the illumination divided out;
    its frame number alone where the other keyframes contradict it."""
    confidence = check.confidence(place, keyframe.confidence)
    if confidence is None:
        return keyframe.index
    rgb = keyframe.rgb
    if illumination is not None:
        rgb = illumination.shading_corrected(rgb, keyframe.depth, intrinsics)
    return replace(keyframe, rgb=rgb, confidence=confidence)


def _fitted_illumination(completed: CompletedSubmap, settings: SurfaceSettings) -> Illumination | None:
    """The submap's illumination, fitted to keyframes spread over it; None where they have too little depth."""
    spread = np.unique(np.linspace(0, len(completed) - 1, min(ILLUMINATION_SAMPLES, len(completed))).astype(int))
    keyframes = (completed.keyframe(int(completed.rows[place])) for place in spread)
    return fit_illumination(
        ((k.rgb, k.depth) for k in keyframes), completed.camera.matrix, settings.seed, settings.lamp
    )


def fusion_ranges(completed: CompletedSubmap, settings: FusionSettings) -> TsdfSettings | None:
    """Voxel size and truncation in scene units: from the config, or from a sample of the keyframes; None without
    depth."""
    step = max(1, len(completed) // VOXEL_SAMPLES)
    depths = [completed.depth(int(row))[0] for row in completed.rows[::step]]
    if not any((depth > 0).any() for depth in depths):
        return None
    return TsdfSettings(
        voxel_size=settings.voxel_size or choose_voxel_size(depths, completed.camera.matrix),
        truncation=TRUNCATION_VOXELS,
        min_observations=settings.min_observations,
    )


def depth_filter(
    completed: CompletedSubmap, consistency: ConsistencySettings, settings: FusionSettings, ranges: TsdfSettings
) -> DepthFilter:
    """The filter of a submap that is fused in voxels of `ranges`."""
    max_error = settings.max_error_voxels * ranges.voxel_size
    return DepthFilter(completed, consistency, settings.min_confidence, max_error)


def _sentence(surface: Surface) -> str:
    mesh, unit, left_out = surface.mesh, unit_label(surface.scale.unit), len(surface.left_out)
    share = f"{100 * surface.opened_share:.2f} %"
    opened = f"{share} was too dark for its depth and left open; " if surface.opened_share else ""
    without = f"; without {counted(left_out, 'keyframe')} that the others contradict" if left_out else ""
    return (
        f"surface of {len(mesh.faces)} triangles, voxel {surface.voxel_size:.3g} {unit}; "
        f"{100 * surface.dropped_share:.1f} % of the area was loose and dropped; {opened}{surface.scale}{without}"
    )
