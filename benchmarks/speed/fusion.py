"""How long a frame takes to fuse: ours beside Open3D's two, same frames, same voxels, same truncation, one run.

    python -m benchmarks.speed fusion ../shared/data/ctcolon --voxel-mm 0.5 --json fusion_speed.json

RGB-D folder with true depth and poses. Peers: Open3D's tensor `VoxelBlockGrid.integrate` (with the search for the
blocks that a frame touches, without which it cannot be called) and the legacy `ScalableTSDFVolume.integrate`. Neither
weighs its observations; ours does, per pixel, and keeps confidence and counts as well. Reading images is not timed. The
first frame warms up and is left out. A peer whose surface has less than half of our triangles did not do the work; its
time is marked so (Open3D 0.20.0's legacy volume on the machine of the stated figures is one). Memory: of our voxels at
the end, and what that makes for a metre of a lumen 46 mm wide by the area of the surface.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.common.record import spread
from benchmarks.common.runner import add_folder
from haustra.core.camera import read_camera
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.fusion.tsdf import SurfaceFusion, TsdfSettings
from reconstruction.mesh.open3d_import import import_open3d

LUMEN_MM = 46.0
BLOCK_BYTES = 14 * 1024  # reconstruction/fusion/voxel_grid.py
DEPTH_UNIT_MM = np.float32(0.01)  # of a count of the depth PNGs
GRID, VOLUME = "Open3D VoxelBlockGrid", "Open3D ScalableTSDFVolume"
Integrate = Callable[[np.ndarray, np.ndarray, np.ndarray], object]  # rgb, depth mm, world_from_camera


def ours(settings: TsdfSettings, intrinsics: np.ndarray) -> tuple[SurfaceFusion, Integrate]:
    fusion = SurfaceFusion(settings)
    sure: dict[str, np.ndarray] = {}

    def integrate(rgb: np.ndarray, depth: np.ndarray, world_from_camera: np.ndarray) -> object:
        confidence = sure.setdefault("all", np.full(depth.shape, 0.9, np.float32))
        return fusion.integrate(rgb, depth, confidence, intrinsics, world_from_camera)

    return fusion, integrate


def tensor_peer(settings: TsdfSettings, intrinsics: np.ndarray) -> tuple[Callable[[], int], Integrate]:
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

    def integrate(rgb: np.ndarray, depth: np.ndarray, world_from_camera: np.ndarray) -> object:
        image, colour = o3d.t.geometry.Image(depth), o3d.t.geometry.Image(rgb.astype(np.float32) / 255)
        extrinsic, far, reach = (
            core.Tensor(np.linalg.inv(world_from_camera)),
            float(settings.max_depth),
            settings.truncation,
        )
        near = grid.compute_unique_block_coordinates(image, matrix, extrinsic, 1.0, far, reach)
        return grid.integrate(near, image, colour, matrix, extrinsic, 1.0, far, reach)

    return lambda: len(grid.extract_triangle_mesh(weight_threshold=0.5).triangle.indices), integrate


def legacy_peer(
    settings: TsdfSettings, intrinsics: np.ndarray, width: int, height: int
) -> tuple[Callable[[], int], Integrate]:
    o3d = import_open3d()
    volume = o3d.pipelines.integration.ScalableTSDFVolume(
        voxel_length=settings.voxel_size,
        sdf_trunc=settings.truncation * settings.voxel_size,
        color_type=o3d.pipelines.integration.TSDFVolumeColorType.RGB8,
    )
    camera = o3d.camera.PinholeCameraIntrinsic(width, height, intrinsics)

    def integrate(rgb: np.ndarray, depth: np.ndarray, world_from_camera: np.ndarray) -> object:
        image = o3d.geometry.RGBDImage.create_from_color_and_depth(
            o3d.geometry.Image(np.ascontiguousarray(rgb)),
            o3d.geometry.Image(depth),
            depth_scale=1.0,
            depth_trunc=float(settings.max_depth),
            convert_rgb_to_intensity=False,
        )
        return volume.integrate(image, camera, np.linalg.inv(world_from_camera))

    return lambda: len(volume.extract_triangle_mesh().triangles), integrate


Frame = tuple[np.ndarray, np.ndarray, np.ndarray]  # rgb (H,W,3), depth (H,W) mm, world_from_camera (4,4)


def frames_of(folder: Path, count: int) -> Iterator[Frame]:
    """So many frames, spread over the film."""
    _, world_from_camera = read_tum(folder / "trajectory.txt")
    for index in np.linspace(0, len(world_from_camera) - 1, min(count, len(world_from_camera))).astype(int):
        rgb = cv2.cvtColor(cv2.imread(str(folder / "rgb" / f"{index:05d}.png")), cv2.COLOR_BGR2RGB)
        raw = cv2.imread(str(folder / "depth" / f"{index:05d}.png"), cv2.IMREAD_UNCHANGED)
        yield rgb, raw.astype(np.float32) * DEPTH_UNIT_MM, world_from_camera[index]


def milliseconds(frames: Iterator[Frame], methods: dict[str, Integrate]) -> dict[str, Any]:
    """Of each method a frame, without the first frame."""
    times: dict[str, list[float]] = {name: [] for name in methods}
    for frame in frames:
        for name, integrate in methods.items():
            start = time.perf_counter()
            integrate(*frame)
            times[name].append(1e3 * (time.perf_counter() - start))
    return {name: spread(values[1:]) for name, values in times.items()}


def print_methods(figures: dict[str, Any], faces: dict[str, int], size: str) -> None:
    for name, of in figures.items():
        idle = "" if 2 * faces[name] > faces["ours"] else "; NOT COMPARABLE: it left nearly everything out"
        print(
            f"{name}: {of['median']:.1f} ms a frame ({of['min']:.1f}-{of['max']:.1f}, {len(of['values'])} frames of "
            f"{size}), {of['median'] / figures[GRID]['median']:.2f} of Open3D's tensor grid; {faces[name]} "
            f"triangles{idle}"
        )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folder(parser)
    parser.add_argument("--voxel-mm", type=float, default=0.5)
    parser.add_argument("--truncation", type=float, default=8.0, help="voxels")
    parser.add_argument("--max-depth-mm", type=float, default=100.0)
    parser.add_argument("--frames", type=int, default=40)


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """All three on each frame in turn."""
    camera = read_camera(arguments.folder / "camera.json")
    settings = TsdfSettings(arguments.voxel_mm, arguments.truncation, arguments.max_depth_mm)
    fusion, mine = ours(settings, camera.matrix)
    grid_faces, grid = tensor_peer(settings, camera.matrix)
    volume_faces, volume = legacy_peer(settings, camera.matrix, camera.width, camera.height)
    methods = {"ours": mine, GRID: grid, VOLUME: volume}
    figures = milliseconds(frames_of(arguments.folder, arguments.frames), methods)
    surface = fusion.extract()
    faces = {"ours": len(surface.faces), GRID: grid_faces(), VOLUME: volume_faces()}
    print_methods(figures, faces, f"{camera.width}x{camera.height}")
    area, held = float(surface.face_areas.sum()), fusion.blocks * BLOCK_BYTES / 2**20
    metre = held / area * np.pi * LUMEN_MM * 1000
    print(f"memory: {held:.0f} MiB for {area / 100:.0f} cm^2 of surface; {metre:.0f} MiB for a metre of lumen")
    about = {"voxel_mm": arguments.voxel_mm, "milliseconds": figures}
    return about | {"triangles": faces, "mebibytes_per_metre": metre}
