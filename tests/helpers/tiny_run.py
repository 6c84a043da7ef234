"""A finished run without any video: two submaps in straight tubes, for tests of what shows a run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from haustra.core.camera import Camera
from pipeline.config import Config
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.depth_io import write_confidence, write_depth
from pipeline.depth.keyframe_store import DiskKeyframes
from pipeline.depth.rectification import make_rectifier
from pipeline.input.frames import Frames, write_image
from pipeline.mapping.submap import Submap
from pipeline.run_folder.workspace import Workspace, write_json
from pipeline.surface.coverage_stage import CoverageResult
from pipeline.surface.fusion_stage import Surface
from pipeline.surface.scale import Scale
from reconstruction.mesh.surface_mesh import SurfaceMesh

SIDE = 48
CAMERA = Camera("PINHOLE", SIDE, SIDE, (SIDE / 2, SIDE / 2, SIDE / 2, SIDE / 2))
STEP = 0.05  # of the camera along the tube, whose radius is 1
MM = 25.0
LEFT_OUT = {3: "blurred", 4: "blurred", 50: "black", 51: "black", 70: "overexposed", 90: "no texture", 91: "duplicate"}


@dataclass(frozen=True)
class TinyRun:
    """Everything that `write_page` takes."""

    frames: Frames
    completed: list[CompletedSubmap]
    surfaces: list[Surface]
    coverage: list[CoverageResult]
    metrics: dict[str, Any]
    workspace: Workspace

    @property
    def parts(self) -> tuple[Any, ...]:
        return self.frames, self.completed, self.surfaces, self.coverage, self.metrics, self.workspace


def make_tiny_run(root: Path, first: int = 90, second: int = 30) -> TinyRun:
    """`first` posed frames in millimetres, a gap of five that are not posed, then `second` in scene units."""
    workspace = Workspace(root)
    for folder in (root, workspace.images, workspace.depth, workspace.confidence):
        folder.mkdir(exist_ok=True)
    workspace.record |= {"config": Config().model_dump(mode="json"), "versions": {"haustra": "0"}}
    workspace.record["source"] = {"path": "/films/of somebody/tiny <b>&<b> video.mp4", "sha256": {"source": "0"}}
    total = first + 5 + second + len(LEFT_OUT)
    verdicts = [(index, index / 30, LEFT_OUT.get(index, "used")) for index in range(total)]
    write_json(workspace.frames, {"camera": CAMERA.to_dict(), "frames": verdicts})
    used = np.array([index for index, _, verdict in verdicts if verdict == "used"])
    frames = Frames(used, used / 30, CAMERA, np.full((SIDE, SIDE), 255, np.uint8), {"used": len(used), "blurred": 2})
    completed = [_dense(used[:first], workspace), _dense(used[first + 5 :], workspace)]
    scales = [Scale(MM, "mm", "lumen of 50 mm"), Scale(1.0, "scene", "no scale given")]
    surfaces = [
        Surface(_tube(STEP * len(part) + 2, scale.factor), scale, 0.02 * scale.factor, 0.01)
        for part, scale in zip(completed, scales, strict=True)
    ]
    coverage = [_judgement(root, int(used[first // 2])), CoverageResult({"judged": False, "reason": "too short"}, None)]
    submaps = [
        _figures(part, surface, result) for part, surface, result in zip(completed, surfaces, coverage, strict=True)
    ]
    metrics = {
        "source": "/films/of somebody/tiny <b>&<b> video.mp4",
        "frames": {"total": total, "posed": first + second, "verdicts": frames.verdicts, "notes": ["a <i>note</i>"]},
        "camera": "given",
        "mapper": "global",
        "model": "mscsa",
        "warnings": ["the light contradicts 8 % of the frames"],
        "submaps": submaps,
    }
    return TinyRun(frames, completed, surfaces, coverage, metrics, workspace)


def _dense(frames: np.ndarray, workspace: Workspace) -> CompletedSubmap:
    count, rng = len(frames), np.random.default_rng(1)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 2, 3] = STEP * np.arange(count)
    poses[:, 0, 3] = 0.2 * np.sin(np.arange(count) / 9)
    angle, ahead = rng.uniform(0, 2 * np.pi, (count, 30)), rng.uniform(1.5, 2.5, (count, 30))
    points = np.stack([np.cos(angle), np.sin(angle), ahead + poses[:, 2:3, 3]], axis=-1).reshape(-1, 3)
    seen = [
        (row, 30 * born + k) for born in range(count) for row in range(born, min(born + 5, count)) for k in range(30)
    ]
    observations = np.array(seen)
    offset = points[observations[:, 1]] - poses[observations[:, 0], :3, 3]
    pixels = CAMERA.project(offset)
    submap = Submap(frames, poses, points, np.full(len(points), 0.3), observations, pixels, CAMERA.params)
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5 - SIDE / 2
    wall = np.clip(SIDE / 2 / np.maximum(np.hypot(x, y), 1), 0, 4).astype(np.float32)
    for index in frames.tolist():
        shade = np.clip(200 / wall + 20 * np.sin(x / 3 + index / 2), 0, 255)
        image = np.stack([shade, 0.6 * shade, 0.5 * shade], axis=-1).astype(np.uint8)
        cv2.putText(image, str(index), (8, 30), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255))
        write_image(workspace.image_path(index), image)
        write_depth(workspace.depth_path(index), wall)
        write_confidence(workspace.confidence_path(index), 1 / wall)
    return CompletedSubmap(submap, make_rectifier(CAMERA, 120), np.arange(count), DiskKeyframes(workspace))


def _tube(length: float, factor: float, hours: tuple[float, float] = (0, 12), start: float = 0.0) -> SurfaceMesh:
    """Wall that faces the axis, between two hours of the clock; the lengths of `factor` 1 are radii."""
    turn = np.linspace(hours[0], hours[1], 41) * np.pi / 6
    along = np.linspace(start, start + length, 50)
    a, z = np.meshgrid(turn, along)
    radius = 1 + 0.12 * np.sin(4 * z)
    vertices = np.stack([radius * np.sin(a), -radius * np.cos(a), z], axis=-1).reshape(-1, 3)
    cell = np.arange(50 * 41).reshape(50, 41)[:-1, :-1].ravel()
    faces = np.concatenate([np.stack([cell, cell + 1, cell + 41], 1), np.stack([cell + 1, cell + 42, cell + 41], 1)])
    shade = 150 + 60 * np.sin(5 * a + 3 * z).ravel()
    colours = np.stack([shade, 0.55 * shade, 0.45 * shade], axis=1).astype(np.uint8)
    confidence = np.clip(0.5 + 0.4 * np.sin(a), 0, 1).ravel()
    inside = SurfaceMesh.from_triangles(factor * vertices, faces, colours=colours, confidence=confidence)
    if float(np.mean(np.sum(inside.normals[:, :2] * vertices[:, :2], axis=1))) > 0:
        inside = SurfaceMesh.from_triangles(factor * vertices, faces[:, ::-1], colours=colours, confidence=confidence)
    return inside


def _judgement(root: Path, frame: int) -> CoverageResult:
    patch = _tube(1.0, MM, (2, 4), start=2.0)
    picture = root / "coverage.png"
    cv2.imwrite(str(picture), np.full((40, 120, 3), 200, np.uint8))
    region = {"number": 1, "area": 600.0, "diameter": 27.0, "arc": 60.0, "clock": 3.0, "frame": frame}
    region |= {"seconds": frame / 30, "centre": patch.vertices.mean(axis=0).tolist()}
    record = {"judged": True, "unit": "mm", "covered_percent": 91.2, "stretch": 140.0, "listed_from": 5.0}
    return CoverageResult(record | {"smaller_regions": 2, "missed_regions": [region]}, picture, (patch,))


def _figures(part: CompletedSubmap, surface: Surface, result: CoverageResult) -> dict[str, Any]:
    return {
        "frames": len(part.submap.frames),
        "keyframes": len(part),
        "points": len(part.submap.points),
        "faces": len(surface.mesh.faces),
        "area": float(surface.mesh.face_areas.sum()),
        "path_length": 9.0,
        "voxel_size": surface.voxel_size,
        "unit": surface.scale.unit,
        "scale": surface.scale.origin,
        "contradicted_keyframes": [],
        "coverage": result.record,
        "rectified_share": 1.0,
        "evidence": {"reprojection_px": 0.4, "angle_deg": 6.0, "spearman": -0.9, "contrary": 0.0, "voters": 90},
        "camera": {"trust": "given"},
    }
