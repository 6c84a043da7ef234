"""What a depth sensor does for a film whose pictures show nothing for a second.

    haustra phantom SUITE --suite
    python scripts/simulated_sensor.py SUITE/loop SENSED/loop --noise 0.03 --blind 100 129
    python -m benchmarks.reconstruction blind-stretch SENSED/* --truth SUITE --json benchmarks/results/blind.json
    python -m benchmarks.reconstruction blind-stretch CHOSEN/* --truth CHOOSING --chosen --json (the same)

Tracking (`--fast`, lens given) of each folder without the sensor's depth and with it: submaps, frames posed, and the
ATE of the largest submap after Sim(3), and SE(3) where it is in mm. Then the registration alone: at every 20th frame
the next 30 are taken for blind, true poses are given on both sides, and the first pose after the gap is compared with
the truth: from constant velocity, and registered; None where it is refused. With --chosen this alone, of films that the
registration's limits were chosen on. Rendered by `python scripts/pages/blind_page.py`.
"""

import argparse
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.record import RunTable, print_row
from benchmarks.common.runner import add_folders
from haustra.core.camera import read_camera
from haustra.core.progress import SilentProgress
from haustra.core.ray_table import RayTable
from haustra.core.se3 import angle_between, inverse
from haustra.core.text import read_json
from pipeline.config import FAST_KEYFRAME_MOTION, Config, OdometrySettings
from pipeline.frontend.odometry.bridging.depth_clouds import Clouds, clouds_of
from pipeline.frontend.odometry.bridging.depth_odometry import by_velocity
from pipeline.frontend.odometry.bridging.gap import registered_over_gap
from pipeline.frontend.odometry.frame_io import frame_features
from pipeline.frontend.odometry.front_end import track_frames
from pipeline.given_settings import SensorSettings
from pipeline.input.frames import read_frames
from pipeline.input.sensor.sensor_depth import SensorDepth
from pipeline.input.video import Source
from pipeline.run_folder.creating import create_workspace
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.evaluation.trajectory_metrics import trajectory_errors

GAP, APART = 31, 20  # frames: of a gap, and from one to the next
ROOM = 45  # frames before the first gap, and from the start of the last to the end
ALONE, CHOSEN = "registration", "registration, chosen on"
Array = NDArray[np.float64]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser, "folders of scripts/simulated_sensor.py, named as those of the truth")
    parser.add_argument("--chosen", action="store_true", help="films that limits were chosen on: registration alone")
    parser.add_argument("--truth", type=Path, required=True, help="folder of the films that they were made of")


def measure(arguments: argparse.Namespace) -> None:
    table = RunTable(arguments.json)
    for folder in arguments.folders:
        truth = read_tum(arguments.truth / folder.name / "trajectory.txt")[1]
        for method, depth in (("pictures alone", "none"), ("with the sensor", "auto")):
            if not arguments.chosen and not table.has(folder.name, 0, method):
                figures = tracked(folder, truth, depth)
                table.add(folder.name, 0, {method: figures})
                print_row({"film": folder.name, "method": method} | figures)
        alone = CHOSEN if arguments.chosen else ALONE
        if not table.has(folder.name, 0, alone):
            gaps = registered(folder, truth)
            table.add(folder.name, 0, {alone: {"gaps": gaps}})
            for gap in gaps:
                print_row({"film": folder.name} | gap)


def tracked(folder: Path, truth: Array, depth: str) -> dict[str, Any]:
    odometry = OdometrySettings(keyframe_motion=FAST_KEYFRAME_MOTION)
    sensor = SensorSettings.model_validate({"depth": depth})
    config = Config(camera=str(folder / "camera.json"), front_end="odometry", odometry=odometry, sensor=sensor)
    with (
        tempfile.TemporaryDirectory() as scratch,
        create_workspace(Path(scratch) / "run", folder, config, False) as workspace,
    ):
        frames = read_frames(Source(folder), config.camera, config.frames, workspace, SilentProgress())
        with frame_features(workspace) as features:
            found = track_frames(frames, features, config.front_end_settings, workspace, SilentProgress())
        largest = found.submaps[0]
        estimated, true = largest.world_from_camera, truth[largest.frames]
        se3 = None if depth == "none" else trajectory_errors(estimated, true, "se3").ate_rmse
        return {
            "frames": len(truth),
            "usable": len(frames.index),
            "posed": sum(len(submap.frames) for submap in found.submaps),
            "submaps": len(found.submaps),
            "largest": len(largest.frames),
            "ate_sim3_mm": trajectory_errors(estimated, true, "sim3").ate_rmse,
            "ate_se3_mm": se3,
        }


def registered(folder: Path, truth: Array) -> list[dict[str, Any]]:
    """Of each gap: its last good frame, and the errors of the pose after it."""
    clouds = _clouds(folder)
    rows = []
    for end in range(ROOM, len(truth) - ROOM, APART):
        here = {frame: truth[frame] for frame in range(end + 1)}
        there = {frame: truth[frame] for frame in range(end + GAP, len(truth))}
        found = registered_over_gap(here, there, clouds)
        guess = _off(by_velocity(here, there), truth[end + GAP])
        rows.append({"end": end, "guess": guess, "found": None if found is None else _off(found, truth[end + GAP])})
    return rows


def _off(world_from_camera: Array, true: Array) -> list[float]:
    """Shift, mm, and turn, degrees."""
    off = inverse(true) @ world_from_camera
    return [float(np.linalg.norm(off[:3, 3])), float(np.degrees(angle_between(off, np.eye(4))))]


def _clouds(folder: Path) -> Clouds:
    camera, unit = read_camera(folder / "camera.json"), float(read_json(folder / "camera.json")["depth_unit_mm"])
    files = {int(path.stem): path for path in (folder / "depth").glob("*.png")}
    size = (camera.width, camera.height)
    return clouds_of(SensorDepth(files, SensorSettings(), unit, (0, 0, *size), 1.0, size), RayTable(camera))
