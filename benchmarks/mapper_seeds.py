"""Both front ends and COLMAP's two mappers alone, on sequences with true poses, one run for each seed.

    python -m benchmarks.mapper_seeds SUITE/* ../shared/data/ctcolon --seeds 10 --json mapper_seeds.json

Seed by seed over all sequences; every run is written down, with its commit, as it ends, and a call with the same file
goes on where the one before it stopped. Features and matches of COLMAP are made once for each sequence, with seed 0,
since they take as long as the mapping (how far they depend on the seed was not measured); each seed then maps them with
`global` and with `incremental`. `sfm` is what the front end of that name makes of both: the first, or where it leaves
doubt the better by evidence; `odometry-fast` is odometry with `--fast`. Of every method the models count that
`reconstruct` would keep: the largest, and others that the lamp does not contradict. ATE, rotation and wrong runs are
those of `front_ends.py`, each method's over the frames that it posed. Processor time is the fairer speed: COLMAP
matches and maps with one thread, as `reconstruct` has it, while odometry's last steps use two.
"""

import argparse
import json
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.front_ends import errors_of, processor_seconds, run, store
from benchmarks.record import environment, spread, write
from haustra.core.progress import SilentProgress
from pipeline.config import FAST_KEYFRAME_MOTION, Config, OdometrySettings
from pipeline.frontend.select import WORKER, Judged, believed, best_mapper, colmap_job, is_doubtful, map_by_colmap
from pipeline.input.frames import Frames
from pipeline.run_folder.subprocesses import run_isolated
from pipeline.run_folder.workspace import Workspace
from reconstruction.evaluation.trajectory_io import read_tum

METHODS = ("odometry", "odometry-fast", "sfm", "global", "incremental")
COLMAP = ("global", "incremental")
ODOMETRY = {"odometry": OdometrySettings(), "odometry-fast": OdometrySettings(keyframe_motion=FAST_KEYFRAME_MOTION)}


class Matched:
    """A sequence's frames, and COLMAP's features and matches of them."""

    def __init__(self, folder: Path, scratch: Path) -> None:
        self.config = Config(front_end="sfm", seed=0)
        self.frames, self.workspace = store(folder, self.config, scratch / folder.name)
        job = colmap_job(self.frames, self.config, self.workspace)
        begin = np.array([time.perf_counter(), processor_seconds()])
        run_isolated(WORKER, "match", job, self.workspace.log / "match.log", "matching", SilentProgress())
        self.spent = np.array([time.perf_counter(), processor_seconds()]) - begin  # wall and processor seconds


def by_colmap(matched: Matched, seed: int, truth: np.ndarray) -> dict[str, dict[str, Any]]:
    """The runs of both mappers with one seed, and that of `sfm`."""
    frames, workspace, config = matched.frames, matched.workspace, matched.config
    count = len(frames.index)
    mapped: dict[str, list[Judged]] = {}
    spent: dict[str, np.ndarray] = {}
    for method in COLMAP:
        mapped[method], spent[method] = _timed(method, seed, frames, config, workspace)
    asked = COLMAP if is_doubtful(mapped["global"], count, config) else COLMAP[:1]
    chosen = best_mapper({m: mapped[m] for m in asked}, count)
    runs = {m: _figures(mapped[m], matched.spent + spent[m], count, truth, config) for m in COLMAP}
    both = matched.spent + sum(spent[m] for m in asked)
    return runs | {"sfm": _figures(mapped[chosen], both, count, truth, config) | {"mapper": chosen}}


def _timed(
    method: str, seed: int, frames: Frames, config: Config, workspace: Workspace
) -> tuple[list[Judged], np.ndarray]:
    """One mapper on a copy of the matches, since a mapper may write to them."""
    job = colmap_job(frames, config, workspace)
    copied = workspace.features.with_name("copied.db")
    shutil.copyfile(workspace.features, copied)
    begin = np.array([time.perf_counter(), processor_seconds()])
    models = map_by_colmap(method, job | {"seed": seed, "database": str(copied)}, workspace, SilentProgress())
    return models, np.array([time.perf_counter(), processor_seconds()]) - begin


def _figures(models: list[Judged], spent: np.ndarray, count: int, truth: np.ndarray, config: Config) -> dict[str, Any]:
    """Errors of the models that `reconstruct` would keep; spent: wall and processor seconds."""
    submaps = [submap for submap, _, _ in believed(models, config)]
    posed = sum(len(submap.frames) for submap in submaps) / count
    speed = {"frames_per_s": count / spent[0], "processor_ms_per_frame": 1e3 * spent[1] / count}
    return {"used": count, "posed_share": posed, "submaps": len(submaps)} | speed | errors_of(submaps, truth)


def table(runs: list[dict[str, Any]]) -> None:
    for sequence in dict.fromkeys(r["sequence"] for r in runs):
        for method in METHODS:
            mine = [r for r in runs if (r["sequence"], r["method"]) == (sequence, method)]
            if mine:
                print(f"{sequence:16} {method:13} " + _row(mine))


def _row(runs: list[dict[str, Any]]) -> str:
    wrong = sum(r.get("wrong", True) for r in runs)
    text = f"posed {100 * _median(runs, 'posed_share'):5.1f} % in {_median(runs, 'submaps'):.0f}"
    if any("ate_mm" in r for r in runs):
        ate = spread([r["ate_mm"] for r in runs if "ate_mm" in r])
        text += f", ATE {ate['median']:.3f} [{ate['min']:.3f}, {ate['max']:.3f}] mm"
        text += f", rotation {_median(runs, 'rotation_deg'):.2f} deg"
        text += f", {_median(runs, 'processor_ms_per_frame'):.0f} ms of processor a frame"
    commits = len({r.get("commit") for r in runs})
    return text + f", wrong {wrong} of {len(runs)}" + (f", of {commits} commits" if commits > 1 else "")


def _median(runs: list[dict[str, Any]], name: str) -> float:
    return float(np.median([r[name] for r in runs if name in r]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folders", type=Path, nargs="+", help="RGB-D folders")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--methods", nargs="+", choices=(*ODOMETRY, "colmap"), default=(*ODOMETRY, "colmap"))
    parser.add_argument("--json", type=Path, required=True)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    runs = json.loads(arguments.json.read_text())["runs"] if arguments.json.exists() else []
    done = {(r["sequence"], r["seed"], r["method"]) for r in runs}
    with tempfile.TemporaryDirectory() as scratch:
        matches: dict[str, Matched] = {}
        for seed in range(arguments.seeds):
            for folder in arguments.folders:
                _, truth = read_tum(folder / "trajectory.txt")
                fresh: dict[str, dict[str, Any]] = {}
                for method, settings in ODOMETRY.items():
                    if method in arguments.methods and (folder.name, seed, method) not in done:
                        config = Config(front_end="odometry", seed=seed, odometry=settings)
                        fresh[method] = run(folder, config, truth)
                if "colmap" in arguments.methods and (folder.name, seed, "sfm") not in done:
                    if folder.name not in matches:
                        matches[folder.name] = Matched(folder, Path(scratch))
                    fresh |= by_colmap(matches[folder.name], seed, truth)
                about = {"sequence": folder.name, "seed": seed, "commit": environment()["commit"]}
                runs += [about | {"method": m} | r for m, r in fresh.items()]
                if fresh:
                    write(arguments.json, {"runs": runs})
    table(runs)


if __name__ == "__main__":
    main()
