"""Error that the shipped model expects beside the one that it makes, by stratum: near, far, burnt, border, fold edges.

    python -m benchmarks.completion strata BURNT/* --stride 6 --json strata.json

SfM-like points as `haustra evaluate --sampler sfm` draws them, seed 0. Strata are those of
`completion/evaluation/strata.py`, every pixel of all films the same: share of pixels whose error is below the expected
one (63 % if it is a Laplace scale), mean relative error, share of confidence 0.1 and more, and how many of those err by
less than 5 %.
"""

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.common.record import print_row
from benchmarks.common.runner import add_folders
from completion.evaluation.run import Outputs, evaluate, protocol_of
from haustra.core.progress import SilentProgress

POINTS = (100, 500)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser, "with true depth")
    parser.add_argument("--model", default="mscsa")
    parser.add_argument("--stride", type=int, default=6, help="every n-th frame")


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Every stratum with every number of points."""
    protocols = [protocol_of("sfm", points, "none", "per_frame", 0, arguments.stride) for points in POINTS]
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "evaluated.json"
        evaluate(arguments.folders, [arguments.model], protocols, Outputs(json=path), None, SilentProgress())
        evaluated = json.loads(path.read_text())
    rows = []
    for points in POINTS:
        of_films = [record["strata"] for record in evaluated if record["protocol"]["points"] == points]
        for name in dict.fromkeys(name for film in of_films for name in film):
            rows.append({"stratum": name, "points": points} | pooled([film[name] for film in of_films if name in film]))
            print_row(rows[-1])
    return {"folders": [folder.name for folder in arguments.folders], "stride": arguments.stride, "rows": rows}


def pooled(films: list[dict[str, Any]]) -> dict[str, Any]:
    """One stratum of several films, every pixel the same."""
    pixels = sum(film["pixels"] for film in films)

    def mean(name: str) -> float:
        return sum(film["pixels"] * film[name] for film in films) / max(pixels, 1)

    kept = sum(film["pixels"] * film["kept"] for film in films)
    close = sum(film["pixels"] * film["kept"] * (film["kept_close"] or 0.0) for film in films)
    shares = {"kept": mean("kept"), "kept_close": close / kept if kept else None}
    return {"pixels": pixels, "within_one": mean("within_one"), "abs_rel": mean("abs_rel")} | shares
