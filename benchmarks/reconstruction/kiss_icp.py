"""KISS-ICP alone on clouds of true, sensor-like and completed depth, beside the path of a run.

    python -m benchmarks.reconstruction kiss-icp FOLDER --run RUN --noise 0.02

KISS-ICP (Vizzo et al., RA-L 2023) registers each frame's cloud against a local map, from constant velocity, and sees no
colour. Clouds are of every frame's depth, in mm, one pixel in `--step`: the folder's true depth; the same with Gaussian
noise of a share of it and a twentieth dropped, as a sensor's; and, with a run of the folder in mm, the completed depth
of its keyframes. Errors are of camera centres after SE(3), of the frames that each has.
"""

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.common.runner import add_folder
from haustra.core.camera import read_camera
from haustra.core.errors import HaustraError
from haustra.core.ray_table import RayTable
from pipeline.finished_run import open_run
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.evaluation.trajectory_metrics import associate, trajectory_errors

VOXEL_MM, RANGE_MM = 1.5, (2.0, 120.0)
INITIAL_MM, LEAST_MOTION_MM = 4.0, 0.05  # of the adaptive threshold
DROPPED = 0.05
UNIT_MM = 0.01

Array = NDArray[np.float64]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folder(parser)
    parser.add_argument("--run", type=Path, help="a finished run of the folder, in mm")
    parser.add_argument("--noise", type=float, default=0.02, help="share of the depth, of the sensor-like clouds")
    parser.add_argument("--step", type=int, default=4, help="pixels between two points of a cloud")
    parser.add_argument("--seed", type=int, default=0, help="of the noise")


def measure(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    seconds, truth = read_tum(arguments.folder / "trajectory.txt")
    rng = np.random.default_rng(arguments.seed)
    rows = [
        _row("true depth", truth, registered(true_clouds(arguments.folder, arguments.step))),
        _row(
            f"noise {100 * arguments.noise:g} %",
            truth,
            registered(noisy(cloud, arguments.noise, rng) for cloud in true_clouds(arguments.folder, arguments.step)),
        ),
    ]
    if arguments.run is not None:
        rows += of_run(arguments.run, seconds, truth, arguments.step)
    return rows


def of_run(folder: Path, seconds: Array, truth: Array, step: int) -> list[dict[str, Any]]:
    """KISS-ICP on the run's completed keyframes, and the run's own path at the same keyframes."""
    run = open_run(folder)
    if run.unit() != "mm":
        raise HaustraError(f"the run {folder} is not in mm: its clouds have no scale")
    keyframes = list(run.keyframes())
    rays = _rays(run.completed_submaps[0].camera, step)
    depths = (keyframe.depth[::step, ::step] for keyframe in keyframes)
    clouds = ((rays * depth[..., None])[depth > 0] for depth in depths)
    mine, theirs = associate(np.array([keyframe.seconds for keyframe in keyframes]), seconds)
    own = np.stack([keyframe.world_from_camera for keyframe in keyframes])
    found = registered(clouds)
    return [
        _row("completed depth, keyframes", truth[theirs], found[mine]),
        _row("the run itself, keyframes", truth[theirs], own[mine]),
    ]


def registered(clouds: Iterable[Array]) -> Array:
    """world_from_camera (N,4,4) of clouds (P,3) in the camera's axes, mm."""
    from kiss_icp.config import KISSConfig
    from kiss_icp.kiss_icp import KissICP

    config = KISSConfig()
    config.data.min_range, config.data.max_range = RANGE_MM
    config.data.deskew = False
    config.mapping.voxel_size = VOXEL_MM
    config.adaptive_threshold.initial_threshold = INITIAL_MM
    config.adaptive_threshold.min_motion_th = LEAST_MOTION_MM
    config.registration.max_num_threads = 1
    odometry, world_from_camera = KissICP(config), []
    for cloud in clouds:
        odometry.register_frame(np.ascontiguousarray(cloud, np.float64), np.zeros(len(cloud)))
        world_from_camera.append(np.array(odometry.last_pose))
    return np.stack(world_from_camera)


def true_clouds(folder: Path, step: int) -> Iterable[Array]:
    camera = read_camera(folder / "camera.json")
    rays = _rays(camera, step)
    usable = RayTable(camera).usable[: camera.height, : camera.width][::step, ::step] > 0
    for path in sorted((folder / "depth").glob("*.png")):
        depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[::step, ::step] * UNIT_MM
        yield (rays * depth[..., None])[(depth > 0) & usable]


def noisy(cloud: Array, noise: float, rng: np.random.Generator) -> Array:
    """Points moved along their rays, some dropped."""
    moved = cloud * (1 + noise * rng.standard_normal((len(cloud), 1)))
    return moved[rng.random(len(cloud)) > DROPPED]


def _rays(camera: Any, step: int) -> Array:
    """(h,w,3) of z = 1, of one pixel in `step`."""
    x, y = np.meshgrid(np.arange(0, camera.width, step) + 0.5, np.arange(0, camera.height, step) + 0.5)
    plane, _ = camera.unproject(np.stack([x.ravel(), y.ravel()], axis=1))
    return np.column_stack([plane, np.ones(len(plane))]).reshape(*x.shape, 3)


def _row(name: str, truth: Array, found: Array) -> dict[str, Any]:
    errors = trajectory_errors(found, truth, "se3", "mm")
    length = float(np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1).sum())
    print(
        f"{name:28} ATE RMSE {errors.ate_rmse:8.3f} mm over {length:.0f} mm, rotation median "
        f"{errors.rotation_median_deg:.2f} deg, {errors.count} frames"
    )
    return {
        "clouds": name,
        "ate_rmse_mm": errors.ate_rmse,
        "rotation_deg": errors.rotation_median_deg,
        "path_mm": length,
    }
