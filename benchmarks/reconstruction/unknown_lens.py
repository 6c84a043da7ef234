"""What a film's lens is guessed to be before it is refined: 100 degrees, the mean of 18 colonoscopes, or by the film.

    python -m benchmarks.reconstruction unknown-lens SUITE/* SCOPES/* CTCOLON --json RECORD.json

SCOPES is `haustra phantom SCOPES --suite --config benchmarks/scope_films.yaml`.

Odometry alone (`--fast`) of each film with its lens hidden: frames posed, the largest submap's frames and ATE RMSE
after Sim(3), whether the motion determined the lens, and by how much the lens found shifts what the true one sees, RMS
over the picture, as a share of its width. A film without `camera.json` and `trajectory.txt`, a real one, has no
such errors; `--end` cuts it. A row is added as each run ends; a stopped call goes on where it was.
"""

import argparse
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common.record import RunTable, print_row
from benchmarks.common.runner import add_folders, add_seeds
from haustra.core.camera import Camera, guess_camera
from haustra.core.progress import SilentProgress
from pipeline.config import FAST_KEYFRAME_MOTION, Config, FrameSettings, OdometrySettings
from pipeline.frontend.lens_guess import GUESSES, scores_of_guesses
from pipeline.frontend.odometry.frame_io import frame_features
from pipeline.frontend.odometry.front_end import track_frames
from pipeline.frontend.odometry.self_calibration import lens_shift
from pipeline.input.endomapper_scopes import colonoscope_across
from pipeline.input.frames import read_frames
from pipeline.input.video import Source
from pipeline.mapping.submap import refined_camera
from pipeline.run_folder.creating import create_workspace
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.evaluation.trajectory_metrics import trajectory_errors

STARTS: dict[str, Callable[..., Camera] | None] = {
    "100 degrees": guess_camera,
    "mean colonoscope": colonoscope_across,
    "by the first frames": None,  # as `--camera auto`
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser, "RGB-D folders, or films")
    parser.add_argument("--end", type=float, help="s; frames from it on are left out")
    add_seeds(parser, 1)


def measure(arguments: argparse.Namespace) -> None:
    table = RunTable(arguments.json)
    for film in arguments.folders:
        for seed in range(arguments.seeds):
            for name, start in STARTS.items():
                if not table.has(film.name, seed, name):
                    figures = figures_of(film, start, seed, arguments.end)
                    table.add(film.name, seed, {name: figures})
                    print_row({"film": film.name, "start": name} | figures, digits=4)


def figures_of(film: Path, start: Callable[..., Camera] | None, seed: int, end: float | None) -> dict[str, Any]:
    given = film / "camera.json"
    odometry = OdometrySettings(keyframe_motion=FAST_KEYFRAME_MOTION)
    config = Config(
        camera=str(given) if given.is_file() else "auto",
        front_end="odometry",
        seed=seed,
        odometry=odometry,
        frames=FrameSettings(end_s=end),
    )
    with (
        tempfile.TemporaryDirectory() as scratch,
        create_workspace(Path(scratch) / "run", film, config, False) as workspace,
    ):
        frames = read_frames(Source(film), config.camera, config.frames, workspace, SilentProgress())
        true, size = frames.camera, (frames.camera.width, frames.camera.height)
        told: dict[str, Any] = {}
        if start is None:
            told["scores"] = scores_of_guesses(frames, config.front_end_settings, workspace, SilentProgress())
            start = GUESSES[max(told["scores"], key=lambda name: told["scores"][name])]
        hidden = replace(frames, camera=start(*size, (0, 0, *size)))
        with frame_features(workspace) as features:
            found = track_frames(hidden, features, config.front_end_settings, workspace, SilentProgress())
    about = told | {
        "usable": len(frames.index),
        "posed": sum(len(submap.frames) for submap in found.submaps),
        "submaps": len(found.submaps),
    }
    if not found.submaps:
        return about
    largest = found.submaps[0]
    camera = refined_camera(hidden.camera, largest)
    about |= {
        "largest": len(largest.frames),
        "focal_px": camera.focal[0],
        "determined": camera.params != hidden.camera.params,
        "reprojection_px": float(np.median(largest.error_px)),
    }
    if not given.is_file():
        return about
    truth = read_tum(film / "trajectory.txt")[1][largest.frames]
    return about | {
        "ate_mm": trajectory_errors(largest.world_from_camera, truth, "sim3").ate_rmse,
        "lens_off": lens_shift(true, camera),
    }
