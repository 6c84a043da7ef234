"""Surface of a sequence that has true depth maps but no poses (SimCol3D's ten frames).

    python -m benchmarks.reconstruction depth-against-truth ../shared/data/simcol3d --camera simcol3d --json simcol.json

The mesh is ray-cast from every posed frame and compared with the true depth of that frame, pixel by pixel, after one
scale for the whole sequence (ratio of median depths). Pixels where the mesh is open do not count as errors but are
reported as coverage.
"""

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common.record import print_figures
from benchmarks.common.runner import add_folder
from completion.data.readers import read_evaluation_frames
from haustra.core.camera import Camera, read_camera
from pipeline.config import Config
from pipeline.run import reconstruct
from reconstruction.mesh.mesh_io import read_mesh
from reconstruction.mesh.open3d_import import import_open3d
from reconstruction.mesh.surface_mesh import SurfaceMesh

FPS = 30  # of an image folder


def cast_depths(mesh: SurfaceMesh, camera: Camera, world_from_camera: np.ndarray) -> Iterator[np.ndarray]:
    """Z-depth (H,W) of the mesh from each pose; inf where it is open."""
    o3d = import_open3d()
    scene = o3d.t.geometry.RaycastingScene()
    triangles = (mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
    scene.add_triangles(*(o3d.core.Tensor(array) for array in triangles))
    columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    (fx, fy), (cx, cy) = camera.focal, camera.centre
    rays = np.stack([(columns - cx) / fx, (rows - cy) / fy, np.ones_like(rows)], axis=-1)
    for matrix in world_from_camera:
        world = np.concatenate([np.broadcast_to(matrix[:3, 3], rays.shape), rays @ matrix[:3, :3].T], axis=-1)
        # The rays have z = 1 in the camera, so the parameter of the hit is the z-depth itself.
        yield scene.cast_rays(o3d.core.Tensor(world.astype(np.float32)))["t_hit"].numpy()


def depth_figures(cast: np.ndarray, true: np.ndarray) -> dict[str, float]:
    """Errors of depths (N,H,W), inf = none, against true ones in mm, 0 = none, after one scale for all."""
    both = np.isfinite(cast) & (true > 0)
    scale = np.median(true[both]) / np.median(cast[both])
    error = np.abs(scale * cast[both] - true[both])
    return {
        "covered_share": float(both.mean()),
        "mean_abs_mm": float(error.mean()),
        "median_abs_mm": float(np.median(error)),
        "abs_rel_percent": float(100 * (error / true[both]).mean()),
        "within_1mm_share": float((error < 1).mean()),
    }


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folder(parser, "frames with true depth maps")
    parser.add_argument("--camera", default="auto")
    parser.add_argument("--output", type=Path, help="keep the run folder here")


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """One run; its surface seen from every posed frame."""
    frames = list(read_evaluation_frames(arguments.folder))
    with tempfile.TemporaryDirectory() as scratch:
        output = arguments.output or Path(scratch) / "run"
        result = reconstruct(arguments.folder, output, Config(camera=arguments.camera), overwrite=True)
        seconds, world_from_camera = result.trajectory()
        triangles = result.metrics["submaps"][0]["faces"]
        mesh, camera = read_mesh(result.mesh), read_camera(output / "camera.json")
    true = np.array([frames[round(s * FPS)].depth for s in seconds])
    figures: dict[str, float] = {"posed": len(world_from_camera), "total": len(frames)}
    figures |= depth_figures(np.array(list(cast_depths(mesh, camera, world_from_camera))), true) | {
        "triangles": triangles
    }
    print_figures(figures)
    return {"protocol": "mesh cast from posed frames, one scale (median ratio)", "figures": figures}
