"""Path and surface error of an RGB-D folder fed as `video.mp4`, one run of `reconstruct` for each seed.

    python -m benchmarks.accuracy ../shared/data/ctcolon --seeds 10 --json accuracy.json
    python -m benchmarks.accuracy ../shared/data/ctcolon --seeds 3 --front-end odometry

ATE: RMSE of camera centres after Sim(3). Surface: F-score at 1 mm against the observed truth (every true depth map
back-projected), moved by the same Sim(3). A run is wrong if its median rotation error exceeds 5 degrees.
"""

import argparse
import tempfile
from pathlib import Path
from typing import Any, get_args

from benchmarks.inputs import encode_video
from benchmarks.record import spread, write
from pipeline.compare import compare_run
from pipeline.config import Config
from pipeline.run import reconstruct

FRONT_ENDS = get_args(Config.model_fields["front_end"].annotation)


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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--model", default="mscsa")
    parser.add_argument("--front-end", default="auto", choices=FRONT_ENDS)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    runs: list[dict[str, float]] = []
    failed: list[str] = []
    with tempfile.TemporaryDirectory() as scratch:
        video = encode_video(sorted((arguments.folder / "rgb").glob("*.png")), Path(scratch) / "video.mp4")
        for seed in range(arguments.seeds):
            try:
                runs.append(
                    one_run(
                        arguments.folder,
                        video,
                        Path(scratch) / f"run{seed}",
                        seed,
                        arguments.model,
                        arguments.front_end,
                    )
                )
            except ValueError as error:  # every known failure; it counts as a wrong run
                failed.append(f"seed {seed}: {error}")
                print(failed[-1], flush=True)
                continue
            print(f"seed {seed}: " + ", ".join(f"{name} {value:.4g}" for name, value in runs[-1].items()), flush=True)
    if not runs:
        raise SystemExit("every run failed")
    summary = {name: spread([run[name] for run in runs]) for name in runs[0]}
    wrong = len(failed) + sum(run["rotation_deg"] > 5 for run in runs)
    print(f"wrong runs: {wrong} of {arguments.seeds}; worst ATE {summary['ate_mm']['max']:.4f} mm")
    for name, values in summary.items():
        print(f"{name:16} median {values['median']:.4g}  [{values['min']:.4g}, {values['max']:.4g}]")
    about = {
        "folder": arguments.folder.name,
        "model": arguments.model,
        "front_end": arguments.front_end,
        "seeds": list(range(arguments.seeds)),
    }
    write(arguments.json, {**about, "wrong": wrong, "failed": failed, "figures": summary})


if __name__ == "__main__":
    main()
