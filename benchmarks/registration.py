"""Dense registration of keyframes, and why the pose graph has no such factors: measured against truth.

    python -m benchmarks.registration RUN RGBD_FOLDER --json registration.json

RUN must be a finished run of the folder's frames by a pinhole camera. Keyframes 1, 2, 5 and 10 apart are laid on each
other from the run's own relative pose, with the run's completed depth and, to show that the method works, with true
depth. Errors of the relative poses against truth, medians; `chi2` tells whether the information is honest (6 expected).

Method: projective point to plane. Every sampled pixel of the source is carried into the target and its distance from
the plane there is driven down (Chen and Medioni, IVC 1992; data association by projection after Blais and Levine, PAMI
1995). Residuals are relative to depth, since that is how completed depth errs, and robust. What the surfaces leave
free, as the axis and the roll of a tube, stays where the guess put it and has next to no information. Pixels of one
depth map err together: the Hessian is divided by how many share an error.

Tangents are rotation, translation, log scale, applied from the right: in the source's axes.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.record import write
from pipeline.depth.completion_stage import DenseSubmap, planned_keyframes
from pipeline.frontend.select import load_structure
from pipeline.input.frames import load_frames
from pipeline.run_folder.workspace import open_workspace
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.evaluation.trajectory_metrics import trajectory_errors
from reconstruction.fusion.depth_consistency import DepthView

Array = NDArray[np.float64]

ITERATIONS = 12
GATE = 0.15  # of the depth: farther off the plane is another surface
MIN_COSINE = 0.2  # between the target's normal and its ray; a grazing plane says little
MIN_PAIRS = 200
CORRELATED_PX = 40.0  # side of the square of pixels that share one error of completed depth
APART, PAIRS = (1, 2, 5, 10), 25  # keyframes between two that are laid on each other, and how many pairs
MIN_CONFIDENCE = 0.1
SINGULAR = 1e-3  # of the largest eigenvalue, in units of depth: directions below it are left alone


@dataclass(frozen=True)
class Registration:
    """`target_from_source` (4,4), Sim(3) where the scale was free; (7,7) information, 0 for a scale that was not.

    sigma: robust spread of the residuals, relative to depth. overlap: share of the source's sampled pixels that met
    the target's surface.
    """

    target_from_source: Array
    information: Array
    sigma: float
    overlap: float


def register(
    source: DepthView, target: DepthView, target_from_source: Array, with_scale: bool = False, stride: int = 4
) -> Registration | None:
    """Refine a guess (4,4); the views' own poses are not looked at. None where too few pixels meet."""
    points = _sampled(source, stride)
    if len(points) < MIN_PAIRS:
        return None
    surface, normals = _planes(target)
    unit = float(np.median(points[:, 2]))
    moved, found = np.array(target_from_source, np.float64), None
    for _ in range(ITERATIONS):
        found = _linearised(points, surface, normals, target.intrinsics, moved, unit, with_scale)
        if found is None:
            return None
        step = found.step()
        moved = moved @ _exponential(step)
        if np.abs(step[:3]).max() < 1e-5 and np.abs(step[3:6]).max() < 1e-5 * unit:
            break
    assert found is not None
    shared = max(1.0, (CORRELATED_PX / stride) ** 2)
    return Registration(moved, found.hessian / (found.sigma**2 * shared), found.sigma, found.pairs / len(points))


@dataclass(frozen=True)
class _Linearised:
    hessian: Array  # (7,7), of residuals relative to depth
    gradient: Array  # (7,)
    unit: float
    sigma: float
    pairs: int

    def step(self) -> Array:
        """(7,) Gauss-Newton step along the directions that the surfaces hold; lengths are weighed in units of depth."""
        weigh = np.array([1, 1, 1, self.unit, self.unit, self.unit, 1.0])
        value, vector = np.linalg.eigh(weigh[:, None] * self.hessian * weigh)
        held = value > SINGULAR * value[-1]
        inverse = np.where(held, 1 / np.where(held, value, 1), 0)
        return -weigh * (vector * inverse @ (vector.T @ (weigh * self.gradient)))


def _linearised(
    points: Array, surface: Array, normals: Array, intrinsics: Array, moved: Array, unit: float, with_scale: bool
) -> _Linearised | None:
    local = points @ moved[:3, :3].T + moved[:3, 3]
    ahead = local[:, 2] > 1e-6 * unit
    pixel = local @ intrinsics.T
    column, row = np.floor(pixel[:, :2] / np.where(ahead, pixel[:, 2], 1)[:, None]).astype(np.int64).T
    height, width = surface.shape[:2]
    inside = ahead & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    at = np.flatnonzero(inside)
    normal, foot = normals[row[at], column[at]], surface[row[at], column[at]]
    known = (foot[:, 2] > 0) & (np.abs(normal).sum(axis=1) > 0)
    at, normal, foot = at[known], normal[known], foot[known]
    depth = np.maximum(foot[:, 2], 1e-9)
    off = np.einsum("ni,ni->n", normal, local[at] - foot) / depth
    near = np.abs(off) < GATE
    if near.sum() < MIN_PAIRS:
        return None
    at, normal, off, depth = at[near], normal[near], off[near], depth[near]
    sigma = max(float(1.4826 * np.median(np.abs(off))), 1e-6)
    weight = 1 / (1 + (off / (2 * sigma)) ** 2)
    along = normal @ moved[:3, :3] / depth[:, None]  # of the residual by a shift in the source's axes
    scale = np.einsum("ni,ni->n", along, points[at])[:, None] * float(with_scale)
    jacobian = np.concatenate([np.cross(points[at], along), along, scale], axis=1)
    weighted = jacobian * weight[:, None]
    return _Linearised(weighted.T @ jacobian, weighted.T @ off, unit, sigma, len(at))


def _sampled(view: DepthView, stride: int) -> Array:
    """(N,3) points of every `stride`-th known pixel, in the camera's axes."""
    rows, columns = (
        a.ravel()
        for a in np.mgrid[stride // 2 : view.depth.shape[0] : stride, stride // 2 : view.depth.shape[1] : stride]
    )
    depth = view.depth[rows, columns].astype(np.float64)
    known = depth > 0
    rays = np.column_stack([columns + 0.5, rows + 0.5, np.ones(len(rows))]) @ np.linalg.inv(view.intrinsics).T
    return rays[known] * depth[known, None]


def _planes(view: DepthView) -> tuple[Array, Array]:
    """(H,W,3) points and unit normals in the camera's axes; zero normals beside unknown depth and where grazing."""
    height, width = view.depth.shape
    rows, columns = np.indices((height, width)) + 0.5
    rays = np.stack([columns, rows, np.ones((height, width))], axis=-1) @ np.linalg.inv(view.intrinsics).T
    points = rays * view.depth[..., None]
    across, down = (np.gradient(points, axis=axis) for axis in (1, 0))
    normal = np.cross(across, down)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    normal = normal / np.maximum(length, 1e-12)
    cosine = np.abs(np.einsum("hwi,hwi->hw", normal, rays)) / np.linalg.norm(rays, axis=-1)
    whole = cv2.erode((view.depth > 0).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return points, np.where((whole & (cosine > MIN_COSINE))[..., None], normal, 0.0)


def _exponential(tangent: Array) -> Array:
    """A small Sim(3) step, to first order in the coupling of turn and shift."""
    result = np.eye(4)
    result[:3, :3] = np.exp(tangent[6]) * Rotation.from_rotvec(tangent[:3]).as_matrix()
    result[:3, 3] = tangent[3:6]
    return result


def view(part: DenseSubmap, row: int, folder: Path, unit_mm: float, true_depth: bool) -> DepthView:
    if true_depth:
        index = int(part.submap.frames[row])
        stored: Any = cv2.imread(str(folder / "depth" / f"{index:05d}.png"), cv2.IMREAD_UNCHANGED)
        depth = stored.astype(np.float32) * np.float32(0.01 / unit_mm)
    else:
        depth, confidence, _ = part.depth(row)
        depth = np.where(confidence < MIN_CONFIDENCE, np.float32(0), depth)
    return DepthView(depth, part.camera.matrix, np.eye(4))


def pair_errors(part: DenseSubmap, truth: Array, folder: Path, apart: int, true_depth: bool) -> dict[str, float]:
    """Medians over pairs of keyframes `apart`; truth: (N,4,4) of the submap's frames, mm."""
    poses = part.submap.world_from_camera
    unit_mm = trajectory_errors(poses, truth).scale
    found = []
    for place in range(0, len(part) - apart, max(1, len(part) // PAIRS)):
        rows = int(part.rows[place]), int(part.rows[place + apart])
        views = [view(part, row, folder, unit_mm, true_depth) for row in rows]
        guess, wanted = (np.linalg.inv(p[rows[0]]) @ p[rows[1]] for p in (poses, truth))
        wanted[:3, 3] /= unit_mm
        result = register(views[1], views[0], guess)
        if result is None:
            continue
        before, after = (tangent(np.linalg.inv(m) @ wanted) for m in (guess, result.target_from_source))
        lengths = [np.linalg.norm(v) for v in (before[:3], after[:3], before[3:], after[3:])]
        found.append([*lengths, result.sigma, after @ result.information[:6, :6] @ after])
    median = np.median(found, axis=0)
    return {
        "pairs": len(found),
        "path_deg": float(np.degrees(median[0])),
        "registered_deg": float(np.degrees(median[1])),
        "path_mm": float(median[2] * unit_mm),
        "registered_mm": float(median[3] * unit_mm),
        "sigma": float(median[4]),
        "chi2": float(median[5]),
    }


def tangent(pose: Array) -> Array:
    """(6,) rotation and translation of a small rigid (4,4)."""
    return np.concatenate([Rotation.from_matrix(pose[:3, :3]).as_rotvec(), pose[:3, 3]])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    workspace = open_workspace(arguments.run)
    part = planned_keyframes(load_frames(workspace), load_structure(workspace), workspace)[0]
    truth = read_tum(arguments.folder / "trajectory.txt")[1][part.submap.frames]
    figures: dict[str, Any] = {}
    for name in ("completed", "true"):
        figures[name] = {a: pair_errors(part, truth, arguments.folder, a, name == "true") for a in APART}
        for apart, errors in figures[name].items():
            print(f"{name:10} {apart:2} apart: " + ", ".join(f"{k} {v:.4g}" for k, v in errors.items()), flush=True)
    write(arguments.json, {"run": arguments.run.name, "folder": arguments.folder.name, "figures": figures})


if __name__ == "__main__":
    main()
