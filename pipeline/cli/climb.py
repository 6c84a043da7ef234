"""The command `haustra climb`: films in, a submission to the CLiMB challenge out, as its containers are called.

The contract: `/input/*.mp4` is read; `/output/FILM/RUN/` is written for runs 1 to 5, each with camera_trajectory,
3D_maps and runtime.txt; no network; any user.
"""

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from haustra.core.errors import HaustraError
from pipeline.cli.given_paths import must_be_named_or_exist, must_exist

RUNS = 5  # of a film, as the benchmark asks for


def climb(
    films: Annotated[Path, typer.Argument(help="folder of .mp4 files")] = Path("/input"),
    output: Annotated[Path, typer.Argument(help="folder of the submission: FILM/RUN/")] = Path("/output"),
    runs: Annotated[int, typer.Option(min=1, help="of each film, with seeds 0, 1, ...")] = RUNS,
    camera: Annotated[str, typer.Option(help="auto, a preset's name, or a calibration file")] = "auto",
) -> None:
    """Reconstruct every .mp4 of a folder and write a submission to the CLiMB challenge; done runs are left alone."""
    must_exist(films)
    must_be_named_or_exist("--camera", camera)
    found = sorted(path for path in films.glob("*.mp4") if not path.name.startswith("."))
    if not found:
        raise HaustraError(f"{films} holds no .mp4 file")
    failed = [words for film in found for run in range(1, runs + 1) if (words := _one(film, output, run, camera))]
    for words in failed:
        print(f"failed: {words}", flush=True)
    if failed:
        raise HaustraError(f"{len(failed)} of {len(found) * runs} runs failed; the same command tries them again")


def _one(film: Path, output: Path, run: int, camera: str) -> str:
    """A sentence if the run failed, else nothing."""
    target = output / film.stem / str(run)
    if (target / "runtime.txt").exists():
        return ""
    from pipeline.climb import write_submission
    from pipeline.config import load_config
    from pipeline.run import reconstruct

    # Only odometry has a frame loop, whose time the benchmark scores.
    settings = load_config(None, camera=camera, front_end="odometry", seed=run - 1)
    with tempfile.TemporaryDirectory() as scratch:
        try:
            reconstruct(film, Path(scratch) / "run", settings)
            print(write_submission(Path(scratch) / "run", target), flush=True)
        except HaustraError as error:
            return f"{film.name}, run {run}: {error}"
    return ""
