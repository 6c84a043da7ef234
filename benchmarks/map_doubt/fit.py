"""The probability that a submap is wrong: coefficients from films for choosing, and how it does on others.

    python -m benchmarks.map_doubt fit --choosing FILMS --reported FILMS --maps FOLDER --json map_doubt.json
    python -m benchmarks.map_doubt fit --family colmap ... --json map_doubt_colmap.json

Odometry alone, or COLMAP alone, maps each film in several ways (`FAMILIES` of `maps.py`: seeds, keyframe motion, wrong
lenses, parts), as the structure stage has them run; submaps of `MIN_FRAMES` frames count, also those that its lighting
check drops. Each family of maps has coefficients of its own. What a wrong map is, `pipeline.mapping.map_doubt` says.
Predictors are chosen, and weights fitted, on the films for choosing alone, by the loss on paths that had no part in the
fit. `FOLDER` keeps the submaps: a stopped call goes on where it was, and `--made` takes those that are there. The
record has the coefficients; `ship` writes them to where the pipeline reads them.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import expit

from benchmarks.common.record import environment
from benchmarks.map_doubt.fitting import chosen_predictors, fitted, log_loss, probabilities_left_out
from benchmarks.map_doubt.maps import FAMILIES, is_made, load_maps, make_maps
from benchmarks.map_doubt.rows import path_of, predictors_of, row_of
from pipeline.mapping.map_doubt import PREDICTORS, log_odds

MIN_FRAMES = 20  # of a submap that counts, as in `benchmarks.living`
LIGHT = ("light", "light against it")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--choosing", type=Path, nargs="+", required=True, help="RGB-D folders")
    parser.add_argument("--reported", type=Path, nargs="+", required=True, help="RGB-D folders")
    parser.add_argument("--maps", type=Path, required=True, help="folder for the submaps")
    parser.add_argument("--family", choices=FAMILIES, default="odometry", help="whose maps")
    parser.add_argument("--made", action="store_true", help="track nothing")


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    rows = [
        row
        for role in ("choosing", "reported")
        for film in getattr(arguments, role)
        for row in _rows_of(film, role, arguments)
    ]
    choosing = [row for row in rows if row["role"] == "choosing"]
    found = fit_all(choosing)
    for row, left_out in zip(choosing, found.pop("left_out"), strict=True):
        row["probability"] = left_out
    for row in rows:
        if row["role"] == "reported":
            row["probability"] = probability(row, found["coefficients"])
    return {"environment": environment()} | found | {"maps": rows}


def _rows_of(film: Path, role: str, arguments: argparse.Namespace) -> list[dict[str, Any]]:
    folder, ways = arguments.maps / role, list(FAMILIES[arguments.family][role])
    if not arguments.made:
        make_maps(film, ways, folder)
    rows = []
    for way in ways:
        if is_made(film, way, folder):
            about = {"film": film.name, "role": role, "way": way}
            kept = folder / f"{film.name}, {way}.json"
            if not kept.is_file():
                kept.write_text(json.dumps([row_of(one) for one in load_maps(film, way, folder)]))
            rows += [about | row for row in json.loads(kept.read_text()) if row["frames"] >= MIN_FRAMES]
    return rows


def fit_all(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Of films for choosing: `alone`, the left-out loss of each predictor and of the light's two together; `chosen`,
    the predictors taken and the loss with each; `coefficients`; `left_out`, a probability for each row."""
    wrong, group = np.array([row["wrong"] for row in rows]), [path_of(row["film"]) for row in rows]
    of_rows = [predictors_of(row) for row in rows]
    values = {name: np.array([of_row[name] for of_row in of_rows]) for name in of_rows[0]}

    def left_out(names: list[str]) -> np.ndarray:
        return probabilities_left_out(np.stack([values[name] for name in names], axis=1), wrong, group)

    alone = {name: log_loss(left_out([name]), wrong) for name in values}
    alone["both of the light"] = log_loss(left_out(list(LIGHT)), wrong)
    chosen = chosen_predictors({name: values[name] for name in PREDICTORS}, wrong, group)
    names = [name for name, _ in chosen]
    offset, weights = fitted(np.stack([values[name] for name in names], axis=1), wrong)
    coefficients = {
        "offset": offset,
        "weights": dict(zip(names, weights.tolist(), strict=True)),
        "of_right_maps": {name: float(np.median(values[name][~wrong])) for name in names},
    }
    return {
        "base_rate": float(wrong.mean()),
        "base_loss": log_loss(np.full(len(wrong), wrong.mean()), wrong),
        "alone": alone,
        "chosen": chosen,
        "coefficients": coefficients,
        "left_out": left_out(names).tolist(),
    }


def probability(row: dict[str, Any], coefficients: dict[str, Any]) -> float:
    """That a row's map is wrong, by given coefficients."""
    return float(expit(log_odds(predictors_of(row), coefficients)))
