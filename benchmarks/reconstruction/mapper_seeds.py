"""Both front ends and COLMAP's two mappers alone, on sequences with true poses, one run for each seed.

    python -m benchmarks.reconstruction mapper-seeds SUITE/* ../shared/data/ctcolon --seeds 10 --json seeds.json

Seed by seed over all sequences; every run is written down, with its commit, as it ends, and a call with the same file
goes on where the one before it stopped. Features and matches of COLMAP are made once for each sequence, with seed 0,
since they take as long as the mapping (how far they depend on the seed was not measured); each seed then maps them with
`global` and with `incremental`. `sfm` is what the front end of that name makes of both: the first, or where it leaves
doubt the better by its score; `odometry-fast` is odometry with `--fast`. Of every method the models count that
`reconstruct` would keep: the largest, and others that the lamp does not contradict. ATE, rotation and wrong runs are
those of `front-ends`, each method's over the frames that it posed. Processor time is the fairer speed: COLMAP
matches and maps with one thread, as `reconstruct` has it, while odometry's last steps use two.
"""

import argparse
import shutil
import tempfile
import time
from itertools import product
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.common.front_end import path_errors, processor_seconds, store
from benchmarks.common.record import RunTable, shown, spread
from benchmarks.common.runner import add_folders, add_seeds
from benchmarks.reconstruction.front_ends import run_front_end
from haustra.core.progress import SilentProgress
from pipeline.config import FAST_KEYFRAME_MOTION, Config, OdometrySettings
from pipeline.frontend.base import COLMAP_WORKER
from pipeline.frontend.colmap.front_end import colmap_job, map_by_colmap
from pipeline.frontend.scoring import Candidate, accepted, best_mapper, candidates_of, needs_second_opinion
from pipeline.input.frames import Frames
from pipeline.run_folder.subprocesses import run_isolated
from pipeline.run_folder.workspace import Workspace
from reconstruction.evaluation.trajectory_io import read_tum

METHODS = ("odometry", "odometry-fast", "sfm", "global", "incremental")
COLMAP = ("global", "incremental")
ODOMETRY = {"odometry": OdometrySettings(), "odometry-fast": OdometrySettings(keyframe_motion=FAST_KEYFRAME_MOTION)}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser)
    add_seeds(parser, 10)
    parser.add_argument("--methods", nargs="+", choices=(*ODOMETRY, "colmap"), default=(*ODOMETRY, "colmap"))


def measure(arguments: argparse.Namespace) -> None:
    """Seed by seed over all sequences; the table writes itself."""
    cv2.setNumThreads(1)
    table = RunTable(arguments.json)
    with tempfile.TemporaryDirectory() as scratch:
        matches: dict[str, Matched] = {}
        for seed, folder in product(range(arguments.seeds), arguments.folders):
            _, truth = read_tum(folder / "trajectory.txt")
            name = folder.name
            fresh: dict[str, dict[str, Any]] = {}
            for method, settings in ODOMETRY.items():
                if method in arguments.methods and not table.has(name, seed, method):
                    config = Config(front_end="odometry", seed=seed, odometry=settings)
                    fresh[method] = run_front_end(folder, config, truth)
            if "colmap" in arguments.methods and not table.has(name, seed, "sfm"):
                if name not in matches:
                    matches[name] = Matched(folder, Path(scratch))
                fresh |= by_colmap(matches[name], seed, truth)
            table.add(name, seed, fresh)
    print_table(table)


class Matched:
    """A sequence's frames, and COLMAP's features and matches of them."""

    def __init__(self, folder: Path, scratch: Path) -> None:
        self.config = Config(front_end="sfm", seed=0)
        self.frames, self.workspace = store(folder, self.config, scratch / folder.name)
        job = colmap_job(self.frames, self.config.seed, self.workspace)
        begin = np.array([time.perf_counter(), processor_seconds()])
        run_isolated(COLMAP_WORKER, "match", job, self.workspace.log / "match.log", "matching", SilentProgress())
        self.spent = np.array([time.perf_counter(), processor_seconds()]) - begin  # wall and processor seconds


def by_colmap(matched: Matched, seed: int, truth: np.ndarray) -> dict[str, dict[str, Any]]:
    """The runs of both mappers with one seed, and that of `sfm`."""
    frames, workspace, config = matched.frames, matched.workspace, matched.config
    count = len(frames.index)
    mapped: dict[str, list[Candidate]] = {}
    spent: dict[str, np.ndarray] = {}
    for method in COLMAP:
        mapped[method], spent[method] = _timed(method, seed, frames, config, workspace)
    asked = COLMAP if needs_second_opinion(mapped["global"], count) else COLMAP[:1]
    chosen = best_mapper({m: mapped[m] for m in asked}, count)
    runs = {m: _figures(mapped[m], matched.spent + spent[m], count, truth) for m in COLMAP}
    both = matched.spent + sum(spent[m] for m in asked)
    return runs | {"sfm": _figures(mapped[chosen], both, count, truth) | {"mapper": chosen}}


def _timed(
    method: str, seed: int, frames: Frames, config: Config, workspace: Workspace
) -> tuple[list[Candidate], np.ndarray]:
    """One mapper on a copy of the matches, since a mapper may write to them."""
    job = colmap_job(frames, config.seed, workspace)
    copied = workspace.features.with_name("copied.db")
    shutil.copyfile(workspace.features, copied)
    begin = np.array([time.perf_counter(), processor_seconds()])
    found = map_by_colmap(method, job | {"seed": seed, "database": str(copied)}, workspace, SilentProgress())
    models = candidates_of(method, found, workspace)
    return models, np.array([time.perf_counter(), processor_seconds()]) - begin


def _figures(models: list[Candidate], spent: np.ndarray, count: int, truth: np.ndarray) -> dict[str, Any]:
    """Errors of the models that `reconstruct` would keep; spent: wall and processor seconds."""
    submaps = [candidate.submap for candidate in accepted(models)]
    posed = sum(len(submap.frames) for submap in submaps) / count
    speed = {"frames_per_s": count / spent[0], "processor_ms_per_frame": 1e3 * spent[1] / count}
    return {"used": count, "posed_share": posed, "submaps": len(submaps)} | speed | path_errors(submaps, truth)


def print_table(table: RunTable) -> None:
    for sequence in dict.fromkeys(r["sequence"] for r in table.runs):
        for method in METHODS:
            if mine := table.of(sequence, method):
                print(f"{sequence:16} {method:13} " + _row(mine))


def _row(runs: list[dict[str, Any]]) -> str:
    wrong = sum(r.get("wrong", True) for r in runs)
    text = f"posed {100 * _median(runs, 'posed_share'):5.1f} % in {_median(runs, 'submaps'):.0f}"
    if any("ate_mm" in r for r in runs):
        ate = spread([r["ate_mm"] for r in runs if "ate_mm" in r])
        text += f", ATE {shown(ate, '.3f')} mm"
        text += f", rotation {_median(runs, 'rotation_deg'):.2f} deg"
        text += f", {_median(runs, 'processor_ms_per_frame'):.0f} ms of processor a frame"
    commits = len({r.get("commit") for r in runs})
    return text + f", wrong {wrong} of {len(runs)}" + (f", of {commits} commits" if commits > 1 else "")


def _median(runs: list[dict[str, Any]], name: str) -> float:
    return float(np.median([r[name] for r in runs if name in r]))
