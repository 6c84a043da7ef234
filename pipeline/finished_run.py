"""A finished run as one object: what `reconstruct` returns, and what `open_run` reads back from a run folder.

Everything is read at its first use and kept, but for the keyframes' pictures, which are read one keyframe at a time.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import HaustraError
from haustra.core.text import counted
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.completion_stage import load_completed
from pipeline.depth.sparse_depth import SparseDepth, SparseDepthMaker
from pipeline.frontend.points_stage import load_points
from pipeline.frontend.structure_stage import load_structure
from pipeline.input.frames import Frames, load_frames
from pipeline.loop_closing.close_loops import load_loops_closed
from pipeline.mapping.submap import Submap
from pipeline.run_folder.workspace import Workspace, open_workspace, report_corruption
from pipeline.surface.coverage_stage import measure_submap, share_seen
from pipeline.surface.fusion_stage import Surface, load_surfaces
from pipeline.surface.scale import unit_label
from reconstruction.coverage.coverage import Coverage
from reconstruction.evaluation.trajectory_io import read_tum

MOST_SAID = 3  # cautions with success


@dataclass(frozen=True)
class RunKeyframe:
    """One completed keyframe in the run's output unit (`Run.unit`).

    frame: number in the source. seconds: its time there. rgb: (H,W,3) uint8, rectified to a pinhole. intrinsics: its K
    (3,3), first pixel's centre at (0.5, 0.5). world_from_camera: (4,4). sparse: its sparse points. depth:
    (H,W) float32 z-depth, 0 = none. confidence: (H,W) float32 in [0,1].
    """

    frame: int
    seconds: float
    rgb: NDArray[np.uint8]
    intrinsics: NDArray[np.float64]
    world_from_camera: NDArray[np.float64]
    sparse: SparseDepth
    depth: NDArray[np.float32]
    confidence: NDArray[np.float32]


class Run:
    """A run folder whose surface is made. Submaps are numbered from 0, most frames first; each has its own world.

    Attributes read from disk at first use: `metrics` (as `metrics.json`), `frames`, `submaps` and `completed_submaps`
    (scene units, as refined by loop closing), `surfaces` (output units), `coverage` (one record a submap).
    """

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace

    @property
    def folder(self) -> Path:
        return self.workspace.root

    @property
    def mesh(self) -> Path:
        """`mesh.ply` of the first submap."""
        return self.workspace.mesh

    def unit(self, submap: int = 0) -> str:
        """'mm', or 'scene' where nothing gave a scale."""
        return self.surfaces[self._checked(submap)].scale.unit

    @cached_property
    def metrics(self) -> dict[str, Any]:
        """Contents of `metrics.json`. Raises `HaustraError` where the report was not written yet."""
        if not self.workspace.is_done("report"):
            raise HaustraError(f"the run {self.folder} is not finished; go on with --resume")
        with report_corruption(self.workspace.metrics):
            return dict(json.loads(self.workspace.metrics.read_text()))

    @cached_property
    def frames(self) -> Frames:
        return load_frames(self.workspace)

    @cached_property
    def submaps_before_loops(self) -> list[CompletedSubmap]:
        """Submaps as the depth stage left them: not merged, and with their loops open."""
        return load_completed(self.frames, load_points(self.submaps_of_front_end, self.workspace), self.workspace)

    @cached_property
    def completed_submaps(self) -> list[CompletedSubmap]:
        return load_loops_closed(self.submaps_before_loops, self.workspace)

    @cached_property
    def submaps_of_front_end(self) -> list[Submap]:
        """Submaps as the front end left them, with its own points."""
        return load_structure(self.workspace)

    @property
    def submaps(self) -> list[Submap]:
        return [completed.submap for completed in self.completed_submaps]

    @cached_property
    def surfaces(self) -> list[Surface]:
        return load_surfaces(self.workspace)

    @property
    def coverage(self) -> list[dict[str, Any]]:
        """Of each submap: percentages, areas, missed regions with place and nearest frame; or why it was not judged."""
        return [submap["coverage"] for submap in self.metrics["submaps"]]

    def trajectory(self, submap: int = 0) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Seconds (N,) and world_from_camera (N,4,4) of all posed frames, in the output unit."""
        self._checked(submap)
        path = self.workspace.trajectory
        path = path if submap == 0 else path.with_name(f"{path.stem}_{submap}{path.suffix}")
        with report_corruption(path):
            return read_tum(path)

    def keyframes(self, submap: int = 0) -> Iterator[RunKeyframe]:
        """The completed keyframes in their order, read from disk one at a time."""
        completed, factor = self.completed_submaps[self._checked(submap)], self.surfaces[submap].scale.factor
        maker = SparseDepthMaker(completed.submap, completed.camera)
        for row in map(int, completed.rows):
            keyframe = completed.keyframe(row)
            world_from_camera = keyframe.world_from_camera.copy()
            world_from_camera[:3, 3] *= factor
            yield RunKeyframe(
                keyframe.index,
                self.frames.seconds_of(keyframe.index),
                keyframe.rgb,
                completed.camera.matrix,
                world_from_camera,
                maker.sparse_depth(row).scaled(factor),
                keyframe.depth * np.float32(factor),
                keyframe.confidence,
            )

    def measure_coverage(self, submap: int = 0) -> Coverage:
        """Measured anew, with every face's flag. Raises `NotATube` where it cannot be judged."""
        return measure_submap(self.frames, self.completed_submaps[self._checked(submap)], self.surfaces[submap])

    def _checked(self, submap: int) -> int:
        """The number of a submap that there is. Raises `HaustraError` for another one."""
        count = len(self.surfaces)
        if not 0 <= submap < count:
            raise HaustraError(
                f"the run {self.folder} has {counted(count, 'submap')}, numbered from 0; there is no {submap}"
            )
        return submap

    def __repr__(self) -> str:
        return f"Run({str(self.folder)!r})"

    def __str__(self) -> str:
        return summary(self.metrics, self.mesh)


def open_run(folder: Path | str) -> Run:
    """A run whose surface is made. Raises `HaustraError` where there is none, or none yet."""
    workspace = open_workspace(Path(folder))
    if not workspace.is_done("surface"):
        raise HaustraError(f"the run {folder} has no mesh yet; go on with it by --resume")
    return Run(workspace)


def summary(metrics: dict[str, Any], mesh: Path) -> str:
    """One line for a person: frames posed, surface, coverage, and any reason not to trust it."""
    main, count = metrics["submaps"][0], len(metrics["submaps"])
    parts = f" in {count} submaps; the largest: {main['frames']} frames" if count > 1 else ""
    return (
        f"{metrics['frames']['posed']} of {metrics['frames']['total']} frames posed{parts}, "
        f"{main['keyframes']} keyframes, "
        f"{main['faces']} triangles, {main['area']:.4g} {unit_label(main['unit'])}^2 of surface; {_coverage(metrics)}: "
        f"{mesh}{_caution(metrics)}"
    )


def _coverage(metrics: dict[str, Any]) -> str:
    seen = metrics["submaps"][0]["coverage"]
    if not seen["judged"]:
        return "coverage not judged"
    count = len(metrics["submaps"])
    where = f" in the largest of {count} submaps" if count > 1 else ""
    bare = seen.get("unmeasured_percent")  # absent in runs of earlier versions
    part = "" if bare is None else f" ({bare:.0f} % in view, but not measured)"
    stretch = f"{seen['stretch']:.3g} {unit_label(seen['unit'])}"
    return f"{share_seen(seen)} of the wall along {stretch} of visited lumen was seen{part}{where}"


def _caution(metrics: dict[str, Any]) -> str:
    """Said with success, so that nobody overlooks it."""
    doubts = metrics["warnings"]
    more = f"; {len(doubts) - MOST_SAID} more on the report" if len(doubts) > MOST_SAID else ""
    return "; CAUTION: " + "; ".join(doubts[:MOST_SAID]) + more if doubts else ""
