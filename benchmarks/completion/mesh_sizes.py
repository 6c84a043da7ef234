"""The mesh of whole runs by the size at which frames are completed.

    python -m benchmarks.completion mesh-sizes CHOOSING/*_b BURNT_CHOOSING/* --json f.json
    python -m benchmarks.completion mesh-sizes CHOOSING/*_b BURNT_CHOOSING/* --of first --json f.json

Films on which settings are chosen, nothing else: a size is taken by this table. Each film is run once, default settings
and seed, lens given; depth and all that follows is then made anew for each size: of the last iteration where points are
many (`SIDE_FOR_MANY` of `completion/inference/resolution.py`), or of the first (`SIDE_OF_FIRST`). F-score at 1 mm,
precision and recall of the mesh, in percent. A film is written as it ends; a stopped call goes on where it was.
"""

import argparse
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.common.record import RunTable, in_percent, print_row
from benchmarks.common.rerun import without_depth
from benchmarks.common.runner import add_folders
from completion.inference import resolution
from pipeline.compare import compare_run
from pipeline.config import Config
from pipeline.run import reconstruct

SETTINGS = {"last": "SIDE_FOR_MANY", "first": "SIDE_OF_FIRST"}  # of `resolution`
SIZES = {"last": (320, 384, 448), "first": (256, 320, 384)}  # px; a first iteration is no larger than the last


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser)
    parser.add_argument("--of", choices=sorted(SETTINGS), default="last", help="iteration whose size is varied")


def measure(arguments: argparse.Namespace) -> None:
    table = RunTable(arguments.json)
    for film in arguments.folders:
        if table.has(film.name, 0, f"{SIZES[arguments.of][-1]} px"):
            continue
        found = figures_of(film, arguments.of)
        table.add(film.name, 0, found)
        for size, figures in found.items():
            print_row({"film": film.name, "size": size} | figures)


def figures_of(film: Path, iteration: str) -> dict[str, dict[str, Any]]:
    """F-score, precision and recall of each size of the first or the last iteration."""
    setting = SETTINGS[iteration]
    found, chosen = {}, getattr(resolution, setting)
    with tempfile.TemporaryDirectory() as scratch:
        made = reconstruct(film, Path(scratch) / "run", Config(camera=str(film / "camera.json")))
        for size in SIZES[iteration]:
            folder = Path(scratch) / str(size)
            without_depth(made, folder)
            try:
                setattr(resolution, setting, size)
                reconstruct(film, folder, made.workspace.config, resume=True)
            finally:
                setattr(resolution, setting, chosen)
            compared = compare_run(folder, film).surface
            assert compared is not None
            found[f"{size} px"] = in_percent(compared)
    return found
