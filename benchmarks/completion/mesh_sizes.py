"""The mesh of whole runs by the size at which frames of many points are completed.

    python -m benchmarks.completion mesh-sizes CHOOSING/*_b BURNT_CHOOSING/* --json f.json

Films on which settings are chosen, nothing else: a size is taken by this table. Each film is run once, default settings
and seed, lens given; depth and all that follows is then made anew for each size of `SIDE_FOR_MANY`
(`completion/inference/resolution.py`). F-score at 1 mm, precision and recall of the mesh, in percent. A film is written
as it ends; a stopped call goes on where it was.
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

SIZES = (320, 384, 448)  # px


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser)


def measure(arguments: argparse.Namespace) -> None:
    table = RunTable(arguments.json)
    for film in arguments.folders:
        if table.has(film.name, 0, f"{SIZES[-1]} px"):
            continue
        found = figures_of(film)
        table.add(film.name, 0, found)
        for size, figures in found.items():
            print_row({"film": film.name, "size": size} | figures)


def figures_of(film: Path) -> dict[str, dict[str, Any]]:
    """F-score, precision and recall of each size."""
    found, chosen = {}, resolution.SIDE_FOR_MANY
    with tempfile.TemporaryDirectory() as scratch:
        made = reconstruct(film, Path(scratch) / "run", Config(camera=str(film / "camera.json")))
        for size in SIZES:
            folder = Path(scratch) / str(size)
            without_depth(made, folder)
            try:
                resolution.SIDE_FOR_MANY = size
                reconstruct(film, folder, made.workspace.config, resume=True)
            finally:
                resolution.SIDE_FOR_MANY = chosen
            compared = compare_run(folder, film).surface
            assert compared is not None
            found[f"{size} px"] = in_percent(compared)
    return found
