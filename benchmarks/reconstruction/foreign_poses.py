"""Poses of COLMAP's model by `--poses`, beside `--front-end sfm`; and what is said of poses in other axes.

    python -m benchmarks.reconstruction foreign-poses CTCOLON --seeds 3 --json benchmarks/results/foreign_poses.json

For each seed `sfm` reconstructs the folder with its lens, and its sparse model is given back as `--poses`: frames
posed, ATE RMSE and F-score at 1 mm after Sim(3). Then the true poses are written as a TUM file in each wrong reading,
and as those of other frames, and each is given as `--poses`: the sentence of the refusal; None where the run goes on.
A row is added as each run ends; a stopped call goes on where it was. Rendered by
`python scripts/pages/known_poses_page.py`.
"""

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.record import RunTable, print_row
from benchmarks.common.runner import add_folder, add_seeds
from haustra.core.errors import HaustraError
from haustra.core.progress import SilentProgress
from haustra.core.se3 import inverse
from pipeline.compare import compare_run
from pipeline.config import Config
from pipeline.frontend.odometry.frame_io import frame_features
from pipeline.frontend.structure_stage import solve_structure
from pipeline.given_settings import PoseSettings
from pipeline.input.frames import read_frames
from pipeline.input.video import Source
from pipeline.run import reconstruct
from pipeline.run_folder.creating import create_workspace
from reconstruction.evaluation.trajectory_io import read_tum, write_tum

SFM, GIVEN = "sfm", "its model as poses"
Array = NDArray[np.float64]
Y_UP, MIRROR = np.diag([1.0, -1.0, -1.0, 1.0]), np.diag([1.0, -1.0, 1.0, 1.0])
WRONG: dict[str, Callable[[Array], Array]] = {
    "inverted (camera_from_world)": lambda truth: np.stack([inverse(matrix) for matrix in truth]),
    "OpenGL's axes": lambda truth: truth @ Y_UP,
    "inverted, OpenGL's axes": lambda truth: np.stack([inverse(matrix @ Y_UP) for matrix in truth]),
    "left-handed (Unity)": lambda truth: MIRROR @ truth @ MIRROR,
    "three frames late": lambda truth: truth[np.maximum(np.arange(len(truth)) - 3, 0)],
    "in reverse order": lambda truth: truth[::-1],
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folder(parser)
    add_seeds(parser, 3)


def measure(arguments: argparse.Namespace) -> None:
    table, folder = RunTable(arguments.json), arguments.folder
    for seed in range(arguments.seeds):
        if not table.has(folder.name, seed, GIVEN):
            found = beside_sfm(folder, seed)
            table.add(folder.name, seed, found)
            for method, figures in found.items():
                print_row({"seed": seed, "method": method} | figures, digits=3)
    for name, wrong in WRONG.items():
        if not table.has(folder.name, 0, name):
            said = sentence_of(folder, wrong)
            table.add(folder.name, 0, {name: {"said": said}})
            print_row({"poses": name, "said": said})


def beside_sfm(folder: Path, seed: int) -> dict[str, dict[str, Any]]:
    """Figures of `sfm`, and of its model given as poses."""
    camera = str(folder / "camera.json")
    with tempfile.TemporaryDirectory() as scratch:
        structured = Path(scratch) / "sfm"
        reconstruct(folder, structured, Config(camera=camera, front_end="sfm", seed=seed))
        model = PoseSettings(file=str(structured / "sparse/0"))
        given = Config(camera=camera, poses=model, seed=seed)
        reconstruct(folder, Path(scratch) / "given", given)
        return {
            name: _figures(Path(scratch) / run, folder) | {"seed": seed}
            for name, run in ((SFM, "sfm"), (GIVEN, "given"))
        }


def _figures(run: Path, truth: Path) -> dict[str, Any]:
    found = compare_run(run, truth)
    assert found.surface is not None
    return {
        "posed": found.posed,
        "frames": found.total,
        "ate_mm": found.sim3.ate_rmse,
        "f": 100 * found.surface.f_score,
    }


def sentence_of(folder: Path, wrong: Callable[[Array], Array]) -> str | None:
    """What is said of the true poses in a wrong reading; None where they are taken."""
    seconds, truth = read_tum(folder / "trajectory.txt")
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "poses.txt"
        write_tum(file, seconds, wrong(truth))
        config = Config(camera=str(folder / "camera.json"), poses=PoseSettings(file=str(file)))
        with (
            create_workspace(Path(scratch) / "run", folder, config, False) as workspace,
            frame_features(workspace) as features,
        ):
            frames = read_frames(Source(folder), config.camera, config.frames, workspace, SilentProgress())
            try:
                solve_structure(frames, features, "poses", config.front_end_settings, workspace, SilentProgress())
            except HaustraError as error:
                return str(error).replace(f"{file}", file.name)
    return None
