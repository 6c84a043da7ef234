"""Error that the shipped model expects beside the one that it makes, by stratum: near, far, burnt, border, fold edges.

    python -m benchmarks.completion strata BURNT/* --stride 6 --json strata.json

Frames as they were filmed, and as `reconstruct` completes them: rectified to a pinhole, which cuts a fisheye's corners.
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

import cv2
import numpy as np

from benchmarks.common.record import print_row
from benchmarks.common.runner import add_folders
from completion.evaluation.outputs import Outputs
from completion.evaluation.run import evaluate, protocol_of
from haustra.core.camera import Camera
from haustra.core.progress import SilentProgress
from pipeline.depth.rectification import make_rectifier

POINTS = (100, 500)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser, "with true depth")
    parser.add_argument("--model", default="mscsa")
    parser.add_argument("--stride", type=int, default=6, help="every n-th frame")


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Every stratum with every number of points."""
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        rectified = [rectified_film(film, Path(scratch) / film.name, arguments.stride) for film in arguments.folders]
        for films, stride in ((arguments.folders, arguments.stride), (rectified, 1)):
            rows += strata_of(films, arguments.model, stride, Path(scratch) / "evaluated.json", films is rectified)
    return {"folders": [folder.name for folder in arguments.folders], "stride": arguments.stride, "rows": rows}


def strata_of(films: list[Path], model: str, stride: int, path: Path, rectified: bool) -> list[dict[str, Any]]:
    """A row for each stratum and number of points, of all films; `path`: where `evaluate` may write."""
    protocols = [protocol_of("sfm", points, "none", "per_frame", 0, stride) for points in POINTS]
    evaluate(films, [model], protocols, Outputs(json=path), None, SilentProgress())
    evaluated = json.loads(path.read_text())
    path.unlink()
    rows = []
    for points in POINTS:
        of_films = [record["strata"] for record in evaluated if record["protocol"]["points"] == points]
        for name in dict.fromkeys(name for film in of_films for name in film):
            row = {"rectified": rectified, "stratum": name, "points": points}
            rows.append(row | pooled([film[name] for film in of_films if name in film]))
            print_row(rows[-1])
    return rows


def rectified_film(film: Path, folder: Path, stride: int) -> Path:
    """Every `stride`-th frame and depth map of a phantom film as its pinhole camera sees them; returns the folder.

    Depth along the optical axis is the same in both cameras, which share that axis.
    """
    about = json.loads((film / "camera.json").read_text())
    rectifier = make_rectifier(Camera(about["model"], about["width"], about["height"], tuple(about["params"])))
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
    for image in sorted((film / "rgb").glob("*.png"))[::stride]:
        for name, resample in (("rgb", rectifier.image), ("depth", rectifier.mask)):
            pixels = np.asarray(cv2.imread(str(film / name / image.name), cv2.IMREAD_UNCHANGED))
            cv2.imwrite(str(folder / name / image.name), resample(pixels))
    pinhole = {"model": "PINHOLE", "params": list(rectifier.camera.params)}
    (folder / "camera.json").write_text(json.dumps(about | pinhole))
    return folder


def pooled(films: list[dict[str, Any]]) -> dict[str, Any]:
    """One stratum of several films, every pixel the same."""
    pixels = sum(film["pixels"] for film in films)

    def mean(name: str) -> float:
        return sum(film["pixels"] * film[name] for film in films) / max(pixels, 1)

    kept = sum(film["pixels"] * film["kept"] for film in films)
    close = sum(film["pixels"] * film["kept"] * (film["kept_close"] or 0.0) for film in films)
    shares = {"kept": mean("kept"), "kept_close": close / kept if kept else None}
    return {"pixels": pixels, "within_one": mean("within_one"), "abs_rel": mean("abs_rel")} | shares
