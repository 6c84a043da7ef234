"""The commands about finished and about many runs: `haustra view` and `haustra batch`."""

import os
from pathlib import Path
from typing import Annotated, Any

import typer

from pipeline.errors import HaustraError


def view(
    run: Annotated[Path, typer.Argument(help="run folder")],
    port: Annotated[int, typer.Option(min=0, help="0: a free one")] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="open it")] = True,
) -> None:
    """Show a run's report in the browser, served to this machine alone until Ctrl-C."""
    from pipeline.view import view as serve

    serve(run, port, browser, lambda sentence: print(sentence, flush=True))


def batch(
    videos: Annotated[list[Path], typer.Argument(help="video files, image folders or RGB-D folders")],
    output: Annotated[Path, typer.Option("--output", "-o", help="folder for all run folders")],
    jobs: Annotated[int | None, typer.Option(min=1, help="videos at a time; half the CPUs if not given")] = None,
    ray: Annotated[
        str | None, typer.Option(help="address of a Ray cluster, or local; needs the extra: cluster")
    ] = None,
    camera: Annotated[str | None, typer.Option(help="auto, a preset's name, or a camera.json")] = None,
    front_end: Annotated[str | None, typer.Option(help="auto (= sfm), sfm, or odometry")] = None,
    model: Annotated[str | None, typer.Option(help="completion model: mscsa, or a weight file")] = None,
    lumen_mm: Annotated[float | None, typer.Option(help="median lumen diameter in mm; sets the scale")] = None,
    config: Annotated[Path | None, typer.Option(help="YAML file of settings")] = None,
    seed: Annotated[int | None, typer.Option(help="of every random step")] = None,
    device: Annotated[str | None, typer.Option(help="auto, cpu or cuda")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="print nothing but the table")] = False,
) -> None:
    """Reconstruct many videos; one that fails never stops the rest, and the same command goes on where it stopped."""
    from pipeline.batch import process_pool, run_batch
    from pipeline.batch_ray import ray_pool
    from pipeline.batch_table import print_table
    from pipeline.config import load_config
    from pipeline.progress import SilentProgress, TerminalProgress

    given: dict[str, Any] = {"camera": camera, "front_end": front_end, "model": model, "lumen_mm": lumen_mm}
    given |= {"seed": seed, "device": device}
    settings = load_config(config, **given)
    given["config"] = config
    words = [
        word
        for name, value in given.items()
        if value is not None
        # Tasks may run elsewhere: files by their full paths.
        for word in (f"--{name.replace('_', '-')}", str(value.resolve() if isinstance(value, Path) else value))
    ]
    workers = jobs or max(1, (os.cpu_count() or 2) // 2)
    pool = process_pool(workers) if ray is None else ray_pool(ray, workers)
    try:
        outcomes = run_batch(videos, output, words, settings, pool, SilentProgress() if quiet else TerminalProgress())
    except KeyboardInterrupt:
        print(f"what was finished is in {output / 'batch.csv'}")
        raise
    print_table(outcomes)
    failed = sum(outcome.status == "failed" for outcome in outcomes)
    if failed:
        raise HaustraError(f"{failed} of {len(outcomes)} videos failed; the same command tries them again")
