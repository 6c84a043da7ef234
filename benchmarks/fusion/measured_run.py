"""One run fused with a depth, each part of the fusion on or off, and measured against truth.

`MeasuredRun` holds the main submap as the depth stage left it, and as the refinement stage moved it.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.fusion.depths import Completed, DepthSource, KeyframeView, completed, own_depth
from haustra.core.camera import Camera
from pipeline.config import Config
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.sparse_depth import SparseDepthMaker
from pipeline.finished_run import open_run
from pipeline.input.frames import Frames
from pipeline.surface.fusion_stage import MIN_COMPONENT, depth_filter, fusion_ranges
from reconstruction.evaluation.reference_surface import ReferenceSurface, read_reference_surface
from reconstruction.evaluation.surface_metrics import surface_errors
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.evaluation.trajectory_metrics import align_poses, associate
from reconstruction.fusion.tsdf import SurfaceFusion, TsdfSettings
from reconstruction.mesh.surface_mesh import SurfaceMesh, drop_small_components

TAU = 1.0  # mm

# What each column of the table fuses with: confidence as weights, consistency between keyframes. With consistency comes
# what the run's filter leaves out by its expected error; without it all depth is fused, however far.
VARIANTS = {
    "plain": (False, False),
    "consistency": (False, True),
    "confidence": (True, False),
    "both": (True, True),
}
UNMOVED = "without pose graph"  # the last of the columns that a depth has, on the map before refinement
Figures = dict[str, Any]
Image = NDArray[np.float32]


@dataclass(frozen=True)
class PosedMap:
    """The main submap before or after refinement; `truth_from_map` (4,4) is the Sim(3) of its posed frames to mm."""

    completed: CompletedSubmap
    truth_from_map: NDArray[np.float64]

    @property
    def mm_per_unit(self) -> float:
        return float(np.cbrt(np.linalg.det(self.truth_from_map[:3, :3])))


@dataclass(frozen=True)
class TrueFilm:
    """Poses of an RGB-D folder: seconds (N,), world_from_camera (N,4,4) mm, the frames' depth PNGs, mm per count."""

    seconds: NDArray[np.float64]
    world_from_camera: NDArray[np.float64]
    depths: list[Path]
    unit: float


class MeasuredRun:
    """A finished run beside the truth of its film."""

    def __init__(self, folder: Path, film: Path) -> None:
        run = open_run(folder)
        workspace, refined = run.workspace, run.completed_submaps[0]
        self.name, self.folder, self.config = folder.name, film, workspace.config
        self.frames, self.film = run.frames, read_film(film)
        self.planned = run.submaps_before_loops
        self.refinement_ran, self.moved = workspace.is_done("refinement"), refined.depth_scale is not None
        self.before = self._posed(self.planned[0])
        self.after = self._posed(refined) if self.moved else self.before

    @cached_property
    def truth(self) -> ReferenceSurface:
        return read_reference_surface(self.folder)

    @cached_property
    def views(self) -> dict[int, KeyframeView]:
        """By frame number, every keyframe that either map fuses."""
        wanted = {int(p.submap.frames[row]) for p in (self.before.completed, self.after.completed) for row in p.rows}
        return {view.keyframe.index: view for completed in self.planned for view in self._views_of(completed, wanted)}

    def _views_of(self, completed: CompletedSubmap, wanted: set[int]) -> Iterator[KeyframeView]:
        rows = [int(row) for row in completed.rows if int(completed.submap.frames[row]) in wanted]
        if not rows:
            return
        true_rows, mm_per_unit = associated(completed, self.frames, self.film), self._posed(completed).mm_per_unit
        maker = SparseDepthMaker(completed.submap, completed.camera)
        for row in rows:
            path = self.film.depths[true_rows[row]] if row in true_rows else None
            sparse = maker.sparse_depth(row)
            yield KeyframeView(completed.keyframe(row), sparse, completed.rectifier, mm_per_unit, path, self.film.unit)

    def _posed(self, completed: CompletedSubmap) -> PosedMap:
        """With the Sim(3) that `haustra compare` fits: poses alone, all posed frames, never the surface."""
        rows = associated(completed, self.frames, self.film)
        posed = completed.submap.world_from_camera[list(rows)]
        return PosedMap(completed, align_poses(posed, self.film.world_from_camera[list(rows.values())]))

    @property
    def about(self) -> Figures:
        """What limits every row of this run alike."""
        completed, scale = self.after.completed, self.after.mm_per_unit
        settings = ranges(completed, self.config)
        return {
            "posed": len(completed.submap.frames),
            "film": len(self.film.world_from_camera),
            "keyframes": len(completed),
            "submaps": len(self.planned),
            "refinement": "moved" if self.moved else "nothing moved" if self.refinement_ran else "not run",
            "mm_per_unit": scale,
            "voxel_mm": settings.voxel_size * scale,
            "max_error_mm": self.config.fusion.max_error_voxels * settings.voxel_size * scale,
        }

    def measure(self, source: DepthSource) -> dict[str, Figures]:
        """Figures of each column that this depth has."""
        made = {index: completed(source, view) for index, view in self.views.items()}
        has_confidence = all(confidence is not None for _, confidence in made.values())
        columns = [name for name, (weighted, _) in VARIANTS.items() if has_confidence or not weighted]
        after = self._with_depths(self.after, made, source.is_true)
        figures = {name: after.figures(*VARIANTS[name], self.config, self.truth) for name in columns}
        if self.moved:
            before = self._with_depths(self.before, made, source.is_true)
            figures[UNMOVED] = before.figures(*VARIANTS[columns[-1]], self.config, self.truth)
        return figures

    def with_own_depth(self) -> "FusedMap":
        """The refined map with the depth that the run wrote."""
        return self._with_depths(self.after, {index: own_depth(view) for index, view in self.views.items()}, False)

    def _with_depths(self, posed: PosedMap, made: dict[int, Completed], is_true: bool) -> "FusedMap":
        index = [int(posed.completed.submap.frames[row]) for row in posed.completed.rows]
        return FusedMap(posed, [self.views[i] for i in index], [made[i] for i in index], is_true)


@dataclass(frozen=True)
class WeightedFrames:
    """What a consistency check asks a submap for: depths (H,W) and weights (H,W) of keyframes in order, their poses."""

    camera: Camera
    depths: list[NDArray[np.float32]]
    weights: list[NDArray[np.float32]]
    world_from_camera: NDArray[np.float64]

    @property
    def rows(self) -> NDArray[np.int64]:
        return np.arange(len(self.depths))

    def __len__(self) -> int:
        return len(self.depths)

    def depth(self, row: int) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float64]]:
        return self.depths[row], self.weights[row], self.world_from_camera[row]


class FusedMap:
    """A map whose keyframes have been given some depth, in the map's units."""

    def __init__(self, posed: PosedMap, views: list[KeyframeView], made: list[Completed], is_true: bool) -> None:
        completed = posed.completed
        scales = np.ones(len(completed.submap.frames)) if completed.depth_scale is None else completed.depth_scale
        factors = np.full(len(completed), 1 / posed.mm_per_unit) if is_true else scales[completed.rows]
        self.posed, self.images = posed, [view.keyframe.rgb for view in views]
        self.depths = [depth * np.float32(factor) for (depth, _), factor in zip(made, factors, strict=True)]
        self.confidences = [confidence for _, confidence in made]

    def figures(self, weighted: bool, consistent: bool, config: Config, truth: ReferenceSurface) -> Figures:
        """Errors of the fused surface in mm, and how many keyframes were left out as contradicted."""
        kept = self.kept(weighted, consistent, config)
        mesh = self.surface(kept, ranges(self.posed.completed, config))
        return errors_of(mesh, truth) | {"left_out": sum(weight is None for weight in kept)}

    def kept(self, weighted: bool, consistent: bool, config: Config) -> list[Image | None]:
        """What each keyframe's depth is fused with, (H,W); None of one that the others contradict."""
        completed, weights = self.posed.completed, self._weights(weighted, config.fusion.min_confidence)
        if not consistent:
            return list(weights)
        frames = WeightedFrames(completed.camera, self.depths, weights, self._world_from_camera)
        settings = ranges(completed, config)
        check = depth_filter(frames, config.consistency, config.fusion, settings)  # type: ignore[arg-type]
        return [check.confidence(place, weight) for place, weight in enumerate(weights)]

    def surface(self, kept: list[Image | None], settings: TsdfSettings) -> SurfaceMesh:
        """What keyframes make with these weights, without its small pieces; mm, the axes of the truth."""
        fusion, matrix = SurfaceFusion(settings), self.posed.completed.camera.matrix
        for image, depth, weight, pose in zip(self.images, self.depths, kept, self._world_from_camera, strict=True):
            if weight is not None:
                fusion.integrate(image, depth, weight, matrix, pose)
        return drop_small_components(fusion.extract(), MIN_COMPONENT)[0].transformed(self.posed.truth_from_map)

    @property
    def _world_from_camera(self) -> NDArray[np.float64]:
        return self.posed.completed.submap.world_from_camera[self.posed.completed.rows]

    def _weights(self, weighted: bool, floor: float) -> list[NDArray[np.float32]]:
        """1 where there is depth; weighted: its confidence, 0 below the least that the run fuses."""
        weights = [(depth > 0).astype(np.float32) for depth in self.depths]
        if weighted:
            for weight, confidence in zip(weights, self.confidences, strict=True):
                assert confidence is not None, "no column of weights for a depth without confidence"
                weight *= np.where(confidence < floor, np.float32(0), confidence)
        return weights


def ranges(completed: CompletedSubmap, config: Config) -> TsdfSettings:
    """Voxel size by the run's own depth, so that it is alike for every source."""
    settings = fusion_ranges(completed, config.fusion)
    assert settings is not None, "a finished run has depth"
    return settings


def errors_of(mesh: SurfaceMesh, truth: ReferenceSurface) -> Figures:
    """As `haustra compare`; an empty mesh has an F of 0 and no distances."""
    if not len(mesh.faces):
        return {"f_score": 0.0, "precision": 0.0, "recall": 0.0, "accuracy_mean": None, "completeness_mean": None}
    return asdict(surface_errors(mesh, truth, TAU, np.random.default_rng(0)))


def read_film(folder: Path) -> TrueFilm:
    seconds, world_from_camera = read_tum(folder / "trajectory.txt")
    depths = sorted((folder / "depth").glob("*.png"))
    if len(depths) != len(world_from_camera):
        raise SystemExit(f"error: {folder} has {len(depths)} depth images for {len(world_from_camera)} poses")
    return TrueFilm(
        seconds, world_from_camera, depths, float(json.loads((folder / "camera.json").read_text())["depth_unit_mm"])
    )


def associated(completed: CompletedSubmap, frames: Frames, film: TrueFilm) -> dict[int, int]:
    """Row of the truth for each row of the submap, by time, half a frame apart at most."""
    mine = np.array([frames.seconds_of(int(index)) for index in completed.submap.frames])
    rows, true_rows = associate(mine, film.seconds, 0.5 * float(np.median(np.diff(film.seconds))))
    return dict(zip(rows.tolist(), true_rows.tolist(), strict=True))
