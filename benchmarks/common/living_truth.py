"""Truth of a film whose wall moves: depth in the pinhole that is fused, and where each point lies at rest."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from haustra.phantom.motion.living_wall import WallState, displaced
from pipeline.depth.rectification import Rectifier
from reconstruction.mesh.mesh_io import read_face_property, read_mesh, read_vertex_property

Array = NDArray[np.float64]
NEIGHBOURS = 3  # vertices between which displacement is interpolated


def true_depth(film: Path, frame: int, rectifier: Rectifier) -> NDArray[np.float32]:
    """z-depth (H,W) mm of a frame as the rectifier's pinhole sees it, 0 = none."""
    unit = json.loads((film / "camera.json").read_text())["depth_unit_mm"]
    depth = cv2.imread(str(film / "depth" / f"{frame:05d}.png"), cv2.IMREAD_UNCHANGED).astype(np.float32) * unit
    if rectifier.map_xy is None:
        return depth
    return cv2.remap(depth, rectifier.map_xy, None, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)


@dataclass(frozen=True)
class TrueMotion:
    """The part of the wall that was seen: vertices at rest, axis (V,3), arc (V,), and the states; none: it is still."""

    vertices: Array
    axis: Array
    arc: Array
    states: list[WallState]

    @classmethod
    def of(cls, film: Path) -> TrueMotion | None:
        """None where the wall is still."""
        if not (film / "wall_motion.json").exists():
            return None
        mesh, seen = read_mesh(film / "mesh.ply"), read_face_property(film / "mesh.ply", "seen")
        rows = np.unique(mesh.faces[seen == 1])
        axis = [read_vertex_property(film / "mesh.ply", f"axis_{name}") for name in "xyz"]
        arc = read_vertex_property(film / "mesh.ply", "arc_mm")
        states = [WallState(**state) for state in json.loads((film / "wall_motion.json").read_text())["frames"]]
        return cls(mesh.vertices[rows], np.stack(axis, axis=1)[rows].astype(float), arc[rows].astype(float), states)

    def moved(self, frame: int) -> Array:
        """Vertices (V,3) mm as they are in a frame."""
        return displaced(self.vertices, self.axis, self.arc, self.states[frame])

    def to_rest(self, points: Array, frame: int) -> Array:
        """What takes points (N,3) mm of the wall in a frame to rest, (N,3)."""
        moved = self.moved(frame)
        distance, nearest = cKDTree(moved).query(points, k=NEIGHBOURS)
        weight = 1 / np.maximum(distance, 1e-3)
        weight /= weight.sum(axis=1, keepdims=True)
        return np.einsum("nk,nkj->nj", weight, (self.vertices - moved)[nearest])
