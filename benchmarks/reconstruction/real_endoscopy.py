"""35 in-vivo sinus frames against the poses that their authors published.

    python -m benchmarks.reconstruction real-endoscopy ../shared/data/sinus --json sinus.json
    python -m benchmarks.reconstruction real-endoscopy ../shared/data/sinus --front-end odometry

The authors' poses are themselves SfM (`motion.yaml`, no unit), so the figure is an agreement, not an error: distances
of camera centres after Sim(3), as a share of the authors' path length and of its extent; angles of orientations after
the same Sim(3), and of one-frame motions, in degrees.
"""

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from benchmarks.common.encode_video import encode_video
from benchmarks.common.record import print_figures
from benchmarks.common.runner import add_folder
from pipeline.config import Config
from pipeline.run import reconstruct
from reconstruction.evaluation.trajectory_metrics import simcol3d_errors, trajectory_errors

FPS = 30


def read_motion(path: Path) -> np.ndarray:
    """(N,4,4) world_from_camera of `motion.yaml`.

    The file does not say which way its poses go. Read as camera_from_world they put the camera on the mirror image of
    our path, rotations 179 degrees off; read as world_from_camera both path and rotations agree. So they are that.
    """
    document = yaml.safe_load(path.read_text())["poses[]"]
    world_from_camera = np.tile(np.eye(4), (len(document), 1, 1))
    for number in range(len(document)):
        published = document[f"poses[{number}]"]
        quaternion = [published["orientation"][axis] for axis in "xyzw"]
        world_from_camera[number, :3, :3] = Rotation.from_quat(quaternion).as_matrix()
        world_from_camera[number, :3, 3] = [published["position"][axis] for axis in "xyz"]
    return world_from_camera


def write_camera(folder: Path, target: Path) -> Path:
    """The authors' intrinsics as a camera file; theirs count from the first pixel's centre, ours from its corner."""
    fx, fy, cx, cy = np.loadtxt(folder / "camera_intrinsics_per_view")[:4]
    camera = {"model": "PINHOLE", "width": 1920, "height": 1080, "params": [fx, fy, cx + 0.5, cy + 0.5]}
    target.write_text(json.dumps(camera))
    return target


def path_figures(estimated: np.ndarray, theirs: np.ndarray) -> dict[str, float]:
    """Agreement of poses (N,4,4) with the authors' of the same frames."""
    errors = trajectory_errors(estimated, theirs, "sim3", "unit of the authors")
    path = float(np.linalg.norm(np.diff(theirs[:, :3, 3], axis=0), axis=1).sum())
    extent = float(np.linalg.norm(np.ptp(theirs[:, :3, 3], axis=0)))
    return {
        "ate_rmse_share_of_path": errors.ate_rmse / path,
        "ate_rmse_share_of_extent": errors.ate_rmse / extent,
        "rotation_median_deg": errors.rotation_median_deg,
        "rotation_max_deg": errors.rotation_max_deg,
        "one_frame_rotation_median_deg": simcol3d_errors(estimated, theirs).rot_median_deg,
    }


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folder(parser, "the sinus frames with `motion.yaml` and `camera_intrinsics_per_view`")
    parser.add_argument("--front-end", choices=["sfm", "odometry"], default="sfm")
    parser.add_argument("--output", type=Path, help="keep the run folder here")


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """One run beside the authors' poses."""
    folder, front_end = arguments.folder, arguments.front_end
    with tempfile.TemporaryDirectory() as scratch:
        output = arguments.output or Path(scratch) / "run"
        video = encode_video(sorted(folder.glob("*.jpg")), Path(scratch) / "sinus.mp4", FPS)
        camera = write_camera(folder, Path(scratch) / "camera.json")
        result = reconstruct(video, output, Config(camera=str(camera), front_end=front_end), overwrite=True)
        seconds, world_from_camera = result.trajectory()
        triangles = result.metrics["submaps"][0]["faces"]
    truth = read_motion(folder / "motion.yaml")
    figures: dict[str, float] = {"posed": len(world_from_camera), "total": len(truth)}
    figures |= path_figures(world_from_camera, truth[np.round(seconds * FPS).astype(int)]) | {"triangles": triangles}
    print_figures(figures)
    return {"protocol": f"{front_end}; Sim(3) on camera centres against motion.yaml", "figures": figures}
