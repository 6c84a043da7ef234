"""Surface of a sequence that has true depth maps but no poses (SimCol3D's ten frames).

    python -m benchmarks.depth_against_truth ../shared/data/simcol3d --camera simcol3d --json simcol.json

The mesh is ray-cast from every posed frame and compared with the true depth of that frame, pixel by pixel, after one
scale for the whole sequence (ratio of median depths). Pixels where the mesh is open do not count as errors but are
reported as coverage.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.record import write
from completion.data.readers import read_evaluation_frames
from haustra.core.camera import read_camera
from pipeline.config import Config
from pipeline.run import reconstruct
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.mesh.mesh_io import read_mesh
from reconstruction.mesh.open3d_import import import_open3d


def cast_depths(mesh, camera, poses):
    """Z-depth (H,W) of the mesh from each pose; inf where it is open."""
    o3d = import_open3d()
    scene = o3d.t.geometry.RaycastingScene()
    triangles = (mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
    scene.add_triangles(*(o3d.core.Tensor(array) for array in triangles))
    columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    (fx, fy), (cx, cy) = camera.focal, camera.centre
    rays = np.stack([(columns - cx) / fx, (rows - cy) / fy, np.ones_like(rows)], axis=-1)
    for pose in poses:
        world = np.concatenate([np.broadcast_to(pose[:3, 3], rays.shape), rays @ pose[:3, :3].T], axis=-1)
        # The rays have z = 1 in the camera, so the parameter of the hit is the z-depth itself.
        yield scene.cast_rays(o3d.core.Tensor(world.astype(np.float32)))["t_hit"].numpy()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--camera", default="auto")
    parser.add_argument("--output", type=Path, help="keep the run folder here")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    frames = list(read_evaluation_frames(arguments.folder))
    with tempfile.TemporaryDirectory() as scratch:
        output = arguments.output or Path(scratch) / "run"
        result = reconstruct(arguments.folder, output, Config(camera=arguments.camera), overwrite=True)
        seconds, poses = read_tum(output / "trajectory.tum")
        mesh, camera = read_mesh(output / "mesh.ply"), read_camera(output / "camera.json")
    true = np.array([frames[round(s * 30)].depth for s in seconds])
    cast = np.array(list(cast_depths(mesh, camera, poses)))
    both = np.isfinite(cast) & (true > 0)
    scale = np.median(true[both]) / np.median(cast[both])
    error = np.abs(scale * cast[both] - true[both])
    figures = {
        "posed": len(poses),
        "total": len(frames),
        "covered_share": float(both.mean()),
        "mean_abs_mm": float(error.mean()),
        "median_abs_mm": float(np.median(error)),
        "abs_rel_percent": float(100 * (error / true[both]).mean()),
        "within_1mm_share": float((error < 1).mean()),
        "triangles": result.metrics["submaps"][0]["faces"],
    }
    for name, value in figures.items():
        print(f"{name:18} {value:.4g}")
    write(
        arguments.json,
        {"protocol": "mesh cast from posed frames, one scale (median ratio)", "figures": figures},
    )


if __name__ == "__main__":
    main()
