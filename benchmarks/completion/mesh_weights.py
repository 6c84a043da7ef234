"""The mesh of whole runs by the weights that complete them, and by the greatest error that is fused.

    python -m benchmarks.completion mesh-weights CHOOSING/*_b BURNT_CHOOSING/* --model A.safetensors --model mscsa \\
        --limit 2.5 --limit 3.5 --json f.json

Films on which weights and settings are chosen, nothing else. Each film is run once, default settings and seed, lens
given; depth is then made anew with each weight file, the surface with each `max_error_voxels`. F-score at 1 mm,
precision and recall of the mesh, in percent. A film is written as it ends; a stopped call goes on where it was.
"""

import argparse
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.common.record import RunTable, in_percent, print_row
from benchmarks.common.rerun import without_depth, without_surface
from benchmarks.common.runner import add_folders
from pipeline.compare import compare_run
from pipeline.config import Config
from pipeline.finished_run import Run
from pipeline.run import reconstruct
from pipeline.run_folder.inputs import record_inputs
from pipeline.run_folder.workspace import Workspace


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser)
    parser.add_argument("--model", action="append", required=True, help="shipped name or weight file; repeatable")
    parser.add_argument(
        "--limit", action="append", type=float, help="max_error_voxels; repeatable; the default if none"
    )


def measure(arguments: argparse.Namespace) -> None:
    table = RunTable(arguments.json)
    limits = arguments.limit or [Config().fusion.max_error_voxels]
    for film in arguments.folders:
        if all(table.has(film.name, 0, _name(model, limit)) for model in arguments.model for limit in limits):
            continue
        found = figures_of(film, arguments.model, limits)
        table.add(film.name, 0, found)
        for name, figures in found.items():
            print_row({"film": film.name, "with": name} | figures)


def _name(model: str, limit: float) -> str:
    return f"{Path(model).stem}, {limit:g} voxels"


def figures_of(film: Path, models: list[str], limits: list[float]) -> dict[str, dict[str, Any]]:
    """F-score, precision and recall with each weight file and limit, on one structure."""
    found = {}
    with tempfile.TemporaryDirectory() as scratch:
        structure = reconstruct(film, Path(scratch) / "run", Config(camera=str(film / "camera.json")))
        for number, model in enumerate(models):
            with_depth: Run | None = None
            for limit in limits:
                folder = Path(scratch) / f"{number}_{limit}"
                workspace = without_surface(with_depth, folder) if with_depth else without_depth(structure, folder)
                with_depth = _finished(workspace, film, model, limit)
                compared = compare_run(folder, film).surface
                assert compared is not None
                found[_name(model, limit)] = in_percent(compared)
    return found


def _finished(workspace: Workspace, film: Path, model: str, limit: float) -> Run:
    """The run that a copy becomes whose remaining stages are made with other weights and another limit."""
    settings = workspace.config.model_dump(mode="json")
    settings["model"], settings["fusion"]["max_error_voxels"] = model, limit
    config = Config.model_validate(settings)
    workspace.record |= {"config": settings, "source": record_inputs(film, config)}
    workspace.save()
    return reconstruct(film, workspace.root, config, resume=True)
