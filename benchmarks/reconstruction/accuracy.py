"""Path and surface error of an RGB-D folder fed as `video.mp4`, one run of `reconstruct` for each seed.

    python -m benchmarks.reconstruction accuracy ../shared/data/ctcolon --seeds 10 --json FILE
    python -m benchmarks.reconstruction accuracy ../shared/data/ctcolon --seeds 3 --front-end odometry

ATE: RMSE of camera centres after Sim(3). Surface: F-score at 1 mm against the observed truth (every true depth map
back-projected), moved by the same Sim(3). A run is wrong if its median rotation error exceeds 5 degrees.
"""

import argparse
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.common.encode_video import encode_video
from benchmarks.common.record import shown, spread
from benchmarks.common.runner import add_folder, add_seeds
from pipeline.compare import compare_run
from pipeline.config import Config
from pipeline.frontend.registry import AUTO, FRONT_ENDS
from pipeline.run import reconstruct

WRONG_DEG = 5.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folder(parser)
    add_seeds(parser, 10)
    parser.add_argument("--model", default="mscsa")
    parser.add_argument("--front-end", default="auto", choices=(AUTO, *FRONT_ENDS))


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """A run of each seed; one that fails counts as wrong."""
    folder, model, front_end = arguments.folder, arguments.model, arguments.front_end
    runs, failed = runs_of(folder, arguments.seeds, model, front_end)
    if not runs:
        raise SystemExit("every run failed")
    figures = {name: spread([run[name] for run in runs]) for name in runs[0]}
    wrong = len(failed) + sum(run["rotation_deg"] > WRONG_DEG for run in runs)
    print(f"wrong runs: {wrong} of {arguments.seeds}; worst ATE {figures['ate_mm']['max']:.4f} mm")
    for name, values in figures.items():
        print(f"{name:16} median {shown(values)}")
    about = {"folder": folder.name, "model": model, "front_end": front_end, "seeds": list(range(arguments.seeds))}
    return {**about, "wrong": wrong, "failed": failed, "figures": figures}


def runs_of(folder: Path, seeds: int, model: str, front_end: Any) -> tuple[list[dict[str, float]], list[str]]:
    """Figures of the runs that succeeded, and a sentence on each of the others."""
    runs: list[dict[str, float]] = []
    failed: list[str] = []
    with tempfile.TemporaryDirectory() as scratch:
        video = encode_video(sorted((folder / "rgb").glob("*.png")), Path(scratch) / "video.mp4")
        for seed in range(seeds):
            try:
                runs.append(one_run(folder, video, Path(scratch) / f"run{seed}", seed, model, front_end))
            except ValueError as error:  # every known failure
                failed.append(f"seed {seed}: {error}")
                print(failed[-1], flush=True)
                continue
            print(f"seed {seed}: " + ", ".join(f"{name} {value:.4g}" for name, value in runs[-1].items()), flush=True)
    return runs, failed


def one_run(folder: Path, video: Path, output: Path, seed: int, model: str, front_end: Any) -> dict[str, float]:
    config = Config(camera=str(folder / "camera.json"), seed=seed, model=model, front_end=front_end)
    reconstruct(video, output, config)
    result = compare_run(output, folder)
    return {
        "posed": result.posed,
        "total": result.total,
        "ate_mm": result.sim3.ate_rmse,
        "rotation_deg": result.sim3.rotation_median_deg,
        "f_score": result.surface.f_score,
        "accuracy_mm": result.surface.accuracy_mean,
        "completeness_mm": result.surface.completeness_mean,
    }
