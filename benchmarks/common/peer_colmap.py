"""What people glue together today: COLMAP, linear interpolation, Open3D's own TSDF. The peer of `speed throughput`.

    python -m benchmarks.common.peer_colmap RGBD_FOLDER OUT

COLMAP's incremental mapper with the features and the matching overlap that `reconstruct` uses (so that the peer is not
slowed by worse settings), every posed frame's own points interpolated (Delaunay), all posed frames fused.
"""

import sys
from pathlib import Path
from typing import Any

import cv2  # before pycolmap: see pipeline/frontend/colmap/worker.py
import numpy as np
import pycolmap
from scipy.interpolate import LinearNDInterpolator

from benchmarks.common.colmap_features import extract_and_match
from haustra.core.camera import read_camera
from reconstruction.fusion.tsdf import choose_voxel_size
from reconstruction.mesh.open3d_import import import_open3d


def map_frames(folder: Path, out: Path) -> pycolmap.Reconstruction:
    database = out / "database.db"
    extract_and_match(folder, database)
    options = pycolmap.IncrementalPipelineOptions()
    options.ba_refine_focal_length = options.ba_refine_extra_params = False
    models = pycolmap.incremental_mapping(database, folder / "rgb", out, options)
    return max(models.values(), key=lambda model: model.num_reg_images())


def interpolated_depth(model: pycolmap.Reconstruction, image: pycolmap.Image, shape: tuple[int, int]) -> np.ndarray:
    """(H,W) float32 depth from the frame's own points; 0 outside their hull."""
    pixels = np.array([p.xy for p in image.points2D if p.has_point3D()])
    points = np.array([model.points3D[p.point3D_id].xyz for p in image.points2D if p.has_point3D()])
    depth = (image.cam_from_world() * points)[:, 2]
    rows, columns = np.indices(shape) + 0.5
    return LinearNDInterpolator(pixels, depth, fill_value=0)(columns, rows).astype(np.float32)


def fuse(model: pycolmap.Reconstruction, folder: Path) -> Any:
    """Open3D's legacy mesh of all posed frames."""
    o3d = import_open3d()
    camera = read_camera(folder / "camera.json")
    images = [image for image in model.images.values() if image.has_pose]
    depths = {i.name: interpolated_depth(model, i, (camera.height, camera.width)) for i in images}
    voxel = choose_voxel_size(list(depths.values()), camera.matrix)
    grid = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight", "color"), (o3d.core.float32,) * 3, ((1,), (1,), (3,)), voxel, 8, 20000
    )
    matrix = camera.matrix
    matrix[:2, 2] -= 0.5  # Open3D counts from the first pixel's centre
    for image in images:
        rgb = cv2.imread(str(folder / "rgb" / image.name))[..., ::-1].astype(np.float32)
        integrate(grid, rgb, depths[image.name], matrix, image, voxel)
    return grid.extract_triangle_mesh(weight_threshold=3.0).to_legacy()


def integrate(
    grid: Any, rgb: np.ndarray, depth: np.ndarray, matrix: np.ndarray, image: pycolmap.Image, voxel: float
) -> None:
    """One frame into the voxel grid: rgb (H,W,3), depth (H,W)."""
    o3d = import_open3d()
    camera_from_world = np.eye(4)
    camera_from_world[:3] = image.cam_from_world().matrix()
    extrinsic, intrinsic = o3d.core.Tensor(camera_from_world), o3d.core.Tensor(matrix)
    picture = o3d.t.geometry.Image(o3d.core.Tensor(depth))
    colour = o3d.t.geometry.Image(o3d.core.Tensor(np.ascontiguousarray(rgb)))
    far = float(depth.max()) + voxel
    blocks = grid.compute_unique_block_coordinates(picture, intrinsic, extrinsic, 1.0, far, 4.0)
    grid.integrate(blocks, picture, colour, intrinsic, intrinsic, extrinsic, 1.0, far, 4.0)


def main() -> None:
    folder, out = Path(sys.argv[1]), Path(sys.argv[2])
    out.mkdir(parents=True, exist_ok=True)
    model = map_frames(folder, out)
    mesh = fuse(model, folder)
    import_open3d().io.write_triangle_mesh(str(out / "mesh.ply"), mesh)
    posed = sum(image.has_pose for image in model.images.values())
    print(f"{posed} frames posed, {len(mesh.triangles)} triangles")


if __name__ == "__main__":
    main()
