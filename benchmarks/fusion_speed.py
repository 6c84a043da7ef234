"""How long a frame takes to fuse: ours beside Open3D's two, same frames, same voxels, same truncation, one run.

    python -m benchmarks.fusion_speed ../shared/data/ctcolon --voxel-mm 0.5 --json fusion_speed.json

RGB-D folder with true depth and poses. Peers: Open3D's tensor `VoxelBlockGrid.integrate` (with the search for the
blocks that a frame touches, without which it cannot be called) and the legacy `ScalableTSDFVolume.integrate`. Neither
weighs its observations; ours does, per pixel, and keeps confidence and counts as well. Reading images is not timed. The
first frame warms up and is left out. A peer whose surface has less than half of our triangles did not do the work; its
time is marked so (Open3D 0.20.0's legacy volume on the machine of the stated figures is one). Memory: of our voxels at
the end, and what that makes for a metre of a lumen 46 mm wide by the area of the surface.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from benchmarks.record import spread, write
from haustra.core.camera import read_camera
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.fusion.tsdf import FusionSettings, SurfaceFusion
from reconstruction.mesh.open3d_import import import_open3d

LUMEN_MM = 46.0
BLOCK_BYTES = 14 * 1024  # reconstruction/fusion/voxel_grid.py
Integrate = Callable[[np.ndarray, np.ndarray, np.ndarray], object]  # rgb, depth mm, world_from_camera


def ours(settings: FusionSettings, intrinsics: np.ndarray) -> tuple[SurfaceFusion, Integrate]:
    fusion = SurfaceFusion(settings)
    sure: dict[str, np.ndarray] = {}

    def integrate(rgb: np.ndarray, depth: np.ndarray, pose: np.ndarray) -> object:
        confidence = sure.setdefault("all", np.full(depth.shape, 0.9, np.float32))
        return fusion.integrate(rgb, depth, confidence, intrinsics, pose)

    return fusion, integrate


def tensor_peer(settings: FusionSettings, intrinsics: np.ndarray) -> tuple[Callable[[], int], Integrate]:
    o3d = import_open3d()
    core, voxel = o3d.core, settings.voxel_size
    grid = o3d.t.geometry.VoxelBlockGrid(
        attr_names=("tsdf", "weight", "color"),
        attr_dtypes=(core.float32, core.float32, core.float32),
        attr_channels=(1, 1, 3),
        voxel_size=voxel,
        block_resolution=8,
        block_count=50_000,
    )
    matrix = core.Tensor(intrinsics)

    def integrate(rgb: np.ndarray, depth: np.ndarray, pose: np.ndarray) -> object:
        image, colour = o3d.t.geometry.Image(depth), o3d.t.geometry.Image(rgb.astype(np.float32) / 255)
        extrinsic, far, reach = core.Tensor(np.linalg.inv(pose)), float(settings.max_depth), settings.truncation
        near = grid.compute_unique_block_coordinates(image, matrix, extrinsic, 1.0, far, reach)
        return grid.integrate(near, image, colour, matrix, extrinsic, 1.0, far, reach)

    return lambda: len(grid.extract_triangle_mesh(weight_threshold=0.5).triangle.indices), integrate


def legacy_peer(
    settings: FusionSettings, intrinsics: np.ndarray, width: int, height: int
) -> tuple[Callable[[], int], Integrate]:
    o3d = import_open3d()
    volume = o3d.pipelines.integration.ScalableTSDFVolume(
        voxel_length=settings.voxel_size,
        sdf_trunc=settings.truncation * settings.voxel_size,
        color_type=o3d.pipelines.integration.TSDFVolumeColorType.RGB8,
    )
    camera = o3d.camera.PinholeCameraIntrinsic(width, height, intrinsics)

    def integrate(rgb: np.ndarray, depth: np.ndarray, pose: np.ndarray) -> object:
        image = o3d.geometry.RGBDImage.create_from_color_and_depth(
            o3d.geometry.Image(np.ascontiguousarray(rgb)),
            o3d.geometry.Image(depth),
            depth_scale=1.0,
            depth_trunc=float(settings.max_depth),
            convert_rgb_to_intensity=False,
        )
        return volume.integrate(image, camera, np.linalg.inv(pose))

    return lambda: len(volume.extract_triangle_mesh().triangles), integrate


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--voxel-mm", type=float, default=0.5)
    parser.add_argument("--truncation", type=float, default=8.0, help="voxels")
    parser.add_argument("--max-depth-mm", type=float, default=100.0)
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    camera = read_camera(arguments.folder / "camera.json")
    _, poses = read_tum(arguments.folder / "trajectory.txt")
    settings = FusionSettings(arguments.voxel_mm, arguments.truncation, arguments.max_depth_mm)
    fusion, mine = ours(settings, camera.matrix)
    grid_faces, grid = tensor_peer(settings, camera.matrix)
    volume_faces, volume = legacy_peer(settings, camera.matrix, camera.width, camera.height)
    tracked = {"ours": mine, "Open3D VoxelBlockGrid": grid, "Open3D ScalableTSDFVolume": volume}
    times: dict[str, list[float]] = {name: [] for name in tracked}
    for index in np.linspace(0, len(poses) - 1, min(arguments.frames, len(poses))).astype(int):
        rgb = cv2.cvtColor(cv2.imread(str(arguments.folder / "rgb" / f"{index:05d}.png")), cv2.COLOR_BGR2RGB)
        raw = cv2.imread(str(arguments.folder / "depth" / f"{index:05d}.png"), cv2.IMREAD_UNCHANGED)
        depth = raw.astype(np.float32) * np.float32(0.01)
        for name, integrate in tracked.items():
            start = time.perf_counter()
            integrate(rgb, depth, poses[index])
            times[name].append(1e3 * (time.perf_counter() - start))
    figures = {name: spread(values[1:]) for name, values in times.items()}
    surface = fusion.extract()
    faces = {"ours": len(surface.faces), "Open3D VoxelBlockGrid": grid_faces()}
    faces["Open3D ScalableTSDFVolume"] = volume_faces()
    reference = figures["Open3D VoxelBlockGrid"]["median"]
    for name, of in figures.items():
        idle = "" if 2 * faces[name] > faces["ours"] else "; NOT COMPARABLE: it left nearly everything out"
        print(
            f"{name}: {of['median']:.1f} ms a frame ({of['min']:.1f}-{of['max']:.1f}, {len(of['values'])} frames of "
            f"{camera.width}x{camera.height}), {of['median'] / reference:.2f} of Open3D's tensor grid; "
            f"{faces[name]} triangles{idle}"
        )
    area, held = float(surface.face_areas.sum()), fusion.blocks * BLOCK_BYTES / 2**20
    metre = held / area * np.pi * LUMEN_MM * 1000
    print(f"memory: {held:.0f} MiB for {area / 100:.0f} cm^2 of surface; {metre:.0f} MiB for a metre of lumen")
    write(
        arguments.json,
        {"voxel_mm": arguments.voxel_mm, "milliseconds": figures, "triangles": faces, "mebibytes_per_metre": metre},
    )


if __name__ == "__main__":
    main()
