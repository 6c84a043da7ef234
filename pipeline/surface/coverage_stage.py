"""Stage 6: coverage of every submap's lumen: what the endoscopist missed, its map and its figures."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera
from haustra.core.ray_table import RayTable, ray_table
from haustra.core.text import counted
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.input.frames import Frames
from pipeline.mapping.submap import refined_camera
from pipeline.run_folder.stage import load_or_make
from pipeline.run_folder.workspace import Workspace, report_corruption
from pipeline.surface.fusion_stage import Surface
from pipeline.surface.scale import unit_label
from reconstruction.coverage.centreline import NotATube
from reconstruction.coverage.coverage import Coverage, Segment, measure_coverage
from reconstruction.coverage.coverage_figure import draw_coverage
from reconstruction.coverage.depth_support import DepthSupport
from reconstruction.coverage.missed_regions import MissedRegion, hidden_probability
from reconstruction.coverage.unrolled_map import unroll
from reconstruction.coverage.visibility import FieldOfView
from reconstruction.mesh.surface_mesh import SurfaceMesh

STAGE = "coverage"
# Voxels past the mesh's edge that count as seen: one because all corners of a cell must be known, two because completed
# depth is unsure, and not fused, within some pixels of every rim. Chosen on benchmarks/coverage_films.yaml.
EDGE_VOXELS = 3.0
# Root mean square error of the percentage, in points, on the films of docs/lab/coverage.md that nothing was chosen on.
ERROR_POINTS = 2.9
SEGMENT_MM = 50.0
LISTED_MM = 5.0  # equivalent diameter; an adenoma of 5 mm could hide in it
LISTED_RADII = 0.2  # of the lumen, where millimetres are not known: 5 mm in a lumen of 50 mm
SEGMENT_RADII = 2.0
SECTORS = 120  # around the axis; the edge of each is where its picture reaches farthest, past a thin line of text
NARROWEST_DEG = 10.0  # off the axis; wall where such a picture ends is nearly six radii ahead, past what is judged


@dataclass(frozen=True)
class CoverageResult:
    """Figures of one submap for `metrics.json`; `picture` is None where nothing could be judged. `missed` are the
    closing's surfaces over the listed regions, in their order."""

    record: dict[str, Any]
    picture: Path | None
    missed: tuple[SurfaceMesh, ...] = ()

    @property
    def sentence(self) -> str:
        """What the record says, for a person."""
        record = self.record
        if not record["judged"]:
            return str(record["reason"])
        regions, unit = record["missed_regions"], unit_label(record["unit"])
        return (
            f"{share_seen(record, 1)} of the wall was seen over {record['stretch']:.3g} {unit} of visited "
            f"lumen{_unmeasured(record)}; {counted(len(regions), 'missed region')} of {record['listed_from']:.3g} "
            f"{unit} and more{likely(regions)}, and {record['smaller_regions']} smaller"
        )


def share_seen(record: dict[str, Any], digits: int = 0) -> str:
    """Of a record that is judged, the percentage of wall seen and, where the lens was given, its error."""
    off = record.get("covered_error_points")
    return f"{record['covered_percent']:.{digits}f}{'' if off is None else f' ± {off:.{digits}f}'} %"


def likely(regions: list[dict[str, Any]]) -> str:
    """How many of the regions are more likely hidden than not; nothing of none, and of runs made before it was told."""
    if not regions or any("probability" not in region for region in regions):
        return ""
    return f" ({sum(region['probability'] > 0.5 for region in regions)} of them more likely hidden than not)"


def _unmeasured(record: dict[str, Any]) -> str:
    """Of a run that was made before wall in plain view was told apart, nothing."""
    share = record.get("unmeasured_percent")
    return "" if share is None else f" ({share:.1f} % in plain view only, without a surface)"


def coverage_stage(
    frames: Frames, submaps: list[CompletedSubmap], surfaces: list[Surface], workspace: Workspace
) -> list[CoverageResult]:
    """Measure, draw and list; a submap that is no tube gets one sentence instead of a number."""
    return load_or_make(
        workspace, STAGE, lambda: load_coverage(workspace), lambda: _judge_all(frames, submaps, surfaces, workspace)
    )


def load_coverage(workspace: Workspace) -> list[CoverageResult]:
    """What a finished stage found of each submap."""
    results = []
    for number, record in enumerate(workspace.result(STAGE)["submaps"]):
        picture = coverage_image_path(workspace, number) if record["judged"] else None
        results.append(CoverageResult(record, picture, _load_missed(workspace, number) if picture else ()))
    return results


def _judge_all(frames: Frames, submaps: list[CompletedSubmap], surfaces: list[Surface], workspace: Workspace) -> None:
    records = []
    for number, (completed, surface) in enumerate(zip(submaps, surfaces, strict=True)):
        result = _judge(frames, completed, surface, coverage_image_path(workspace, number))
        arrays = {
            f"{name}_{k}": getattr(m, name) for k, m in enumerate(result.missed) for name in ("vertices", "faces")
        }
        np.savez_compressed(_missed_path(workspace, number), count=len(result.missed), **arrays)
        records.append(json.loads(json.dumps(result.record)))  # plain numbers: YAML knows no NumPy
    workspace.finish(STAGE, submaps=records)


def _load_missed(workspace: Workspace, number: int) -> tuple[SurfaceMesh, ...]:
    path = _missed_path(workspace, number)
    with report_corruption(path), np.load(path, allow_pickle=False) as arrays:
        return tuple(
            SurfaceMesh.from_triangles(arrays[f"vertices_{k}"], arrays[f"faces_{k}"]) for k in range(arrays["count"])
        )


def _missed_path(workspace: Workspace, number: int) -> Path:
    return workspace.log / f"missed_{number}.npz"


def coverage_image_path(workspace: Workspace, number: int) -> Path:
    """`coverage.png` for the first submap, `coverage_1.png` and on for the others."""
    return workspace.coverage if number == 0 else workspace.coverage.with_name(f"coverage_{number}.png")


def measure_submap(frames: Frames, completed: CompletedSubmap, surface: Surface) -> Coverage:
    """Coverage in the run's axes and unit, of the wall that the keyframes' depth bears out. Raises `NotATube`."""
    return measure_supported(frames, completed, surface)[0]


def measure_supported(frames: Frames, completed: CompletedSubmap, surface: Surface) -> tuple[Coverage, SurfaceMesh]:
    """The same, and that wall: what is drawn must be what was measured."""
    factor = surface.scale.factor
    submap = completed.submap.scaled(factor)
    # Before the depth maps are read: a picture that cannot be judged need not wait for them.
    rays = ray_table(refined_camera(frames.camera, completed.submap))
    half, picture = half_field_of_view(rays, completed.camera, frames.content), lens_field_of_view(rays, frames.content)
    support = DepthSupport(surface.mesh)
    for row in completed.rows:
        depth, confidence, _ = completed.depth(int(row))
        support.add(depth * np.float32(factor), confidence, completed.camera.matrix, submap.world_from_camera[row])
    unit, voxel = surface.scale.unit, surface.voxel_size
    supported = support.supported_faces()
    return measure_coverage(supported, submap.world_from_camera, half, unit, EDGE_VOXELS * voxel, picture), supported


def lens_field_of_view(rays: RayTable, content: NDArray[np.uint8]) -> FieldOfView:
    """All that a lens shows on the pixels of `content` (H,W) and is calibrated for."""
    return FieldOfView(rays.project_valid, rays.masked(content) > 0)


def half_field_of_view(rays: RayTable, pinhole: Camera, content: NDArray[np.uint8]) -> float:
    """Degrees off the axis beyond which wall leaves the picture on some side: where what `content` (H,W) leaves of the
    lens's picture is narrowest, or the `pinhole` picture in which depth is completed, if that is narrower.

    Border and burned-in text end a picture as its own edge does; but not text of less than a sector's width, three
    degrees around the axis. Raises `NotATube` where the picture ends at its axis.
    """
    row, column = np.nonzero(rays.masked(content))
    x, y = rays.unproject(np.stack([column, row], axis=1) + 0.5)[0].T
    sector = np.floor((np.arctan2(y, x) / (2 * np.pi) + 0.5) * SECTORS).astype(np.int64) % SECTORS
    outermost = np.zeros(SECTORS)
    np.maximum.at(outermost, sector, np.degrees(np.arctan(np.hypot(x, y))))
    edge = float(outermost.min())
    if edge < NARROWEST_DEG:
        raise NotATube(f"the picture ends {edge:.0f} degrees off its axis, too near to tell what the camera passed")
    (fx, fy), (cx, cy) = pinhole.focal, pinhole.centre
    side = min(cx / fx, (pinhole.width - cx) / fx, cy / fy, (pinhole.height - cy) / fy)
    return min(edge, float(np.degrees(np.arctan(side))))


def _judge(frames: Frames, completed: CompletedSubmap, surface: Surface, picture: Path) -> CoverageResult:
    try:
        coverage, supported = measure_supported(frames, completed, surface)
    except NotATube as reason:
        picture.unlink(missing_ok=True)  # of a report that was made before
        return CoverageResult({"judged": False, "reason": str(reason)}, None)
    unit = surface.scale.unit
    millimetres = unit == "mm"
    smallest = LISTED_MM if millimetres else LISTED_RADII * coverage.radius
    segments = coverage.segments(SEGMENT_MM if millimetres else SEGMENT_RADII * coverage.radius)
    listed = [region for region in coverage.regions if region.diameter >= smallest]
    hidden = hidden_probability(np.array([region.reach for region in listed]) / coverage.radius).tolist()
    draw_coverage(coverage, unroll(coverage, supported, len(listed)), segments, len(listed), picture)
    record = {
        "judged": True,
        "unit": unit,
        "covered_percent": 100 * coverage.share,
        "unmeasured_percent": 100 * coverage.whole.unmeasured_share,
        "seen_area": coverage.whole.seen_area,
        "unmeasured_area": coverage.whole.unmeasured_area,
        "missed_area": coverage.whole.missed_area,
        "stretch": coverage.length,
        "visited": [list(interval) for interval in coverage.visited],
        "lumen_radius": coverage.radius,
        "listed_from": smallest,
        "smaller_regions": len(coverage.regions) - len(listed),
        "segments": [_segment(s) for s in segments],
        "missed_regions": [
            _row(number, region, frames, completed) | {"probability": probability}
            for number, (region, probability) in enumerate(zip(listed, hidden, strict=True), start=1)
        ],
    }
    if frames.camera.trusted:  # with another lens nobody has measured it
        record["covered_error_points"] = ERROR_POINTS
    patches = tuple(coverage.closed_wall.surface.with_faces(coverage.region == k) for k in range(len(listed)))
    return CoverageResult(record, picture, patches)


def _segment(segment: Segment) -> dict[str, float]:
    shares = {"covered_percent": 100 * segment.share, "unmeasured_percent": 100 * segment.unmeasured_share}
    return {"start": segment.start, "end": segment.end, **shares}


def _row(number: int, region: MissedRegion, frames: Frames, completed: CompletedSubmap) -> dict[str, Any]:
    index = int(completed.submap.frames[region.frame])
    return {
        "number": number,
        "area": region.area,
        "diameter": region.diameter,
        "arc": region.arc,
        "arc_from": region.arc_range[0],
        "arc_to": region.arc_range[1],
        "clock": region.clock,
        "centre": list(region.centre),
        "frame": index,
        "seconds": frames.seconds_of(index),
    }
