"""Every row of the README's tables, measured by one command with one commit, written down, and rendered.

    python -m benchmarks.table                                # all rows: `make table`
    python -m benchmarks.table --rows demo --seeds 1          # one of them
    python -m benchmarks.table --render                       # write the README's tables from the record alone

A row's record has its command, commit, machine and seeds, and of each figure the median, the extremes and every value.
Rows of the commit and seeds that are asked for are not measured again, so a stopped command goes on; rows whose data is
not there are named and left. A checkout that is changed elsewhere than in the records is refused: its figures would be
of no commit.
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.common.record import ROOT, environment, in_percent, spread
from benchmarks.common.runner import add_seeds, run

RECORD, README = ROOT / "benchmarks/results/table.json", ROOT / "README.md"
CTCOLON = ROOT.parent / "shared/data/ctcolon"
BEGIN, END = "<!-- figures: begin -->", "<!-- figures: end -->"
DRAWN_POINTS, FRAME_STEP = 100, 8

Figures = dict[str, float]


@dataclass(frozen=True)
class Row:
    """name: as the README says it; needs: a folder without which it cannot be measured; measure: figures of a seed."""

    name: str
    table: str
    command: str
    needs: Path | None
    measure: Callable[[int], Figures]


def of_demo(seed: int) -> Figures:
    from pipeline.demo import CAMERA, FOLDER, VIDEO

    return _of_run(VIDEO, CAMERA, FOLDER, seed)


def of_ctcolon(seed: int) -> Figures:
    return _of_run(CTCOLON, CTCOLON / "camera.json", CTCOLON, seed)


def _of_run(source: Path, camera: Path, truth: Path, seed: int) -> Figures:
    """Frames posed, path and surface of one run against its truth."""
    from pipeline.compare import compare_run
    from pipeline.config import Config
    from pipeline.run import reconstruct

    with tempfile.TemporaryDirectory() as scratch:
        reconstruct(source, Path(scratch) / "run", Config(camera=str(camera), seed=seed))
        errors = compare_run(Path(scratch) / "run", truth)
    assert errors.surface is not None
    about = {"posed": errors.posed, "total": errors.total, "ate_mm": errors.sim3.ate_rmse}
    return about | in_percent(errors.surface)


def of_completion(seed: int) -> Figures:
    """abs.REL in percent of linear interpolation and of the shipped network, mean over every eighth frame."""
    from benchmarks.completion.accuracy import errors_of
    from completion import DepthCompleter
    from completion.data.readers import read_evaluation_frames

    frames = list(read_evaluation_frames(CTCOLON))[::FRAME_STEP]
    completer = DepthCompleter.load("mscsa")
    figures: Figures = {"frames": len(frames)}
    for sampler in ("uniform", "sfm"):
        linear, ours = errors_of(completer, frames, sampler, DRAWN_POINTS, seed).mean(axis=0)
        figures |= {f"{sampler}_linear": float(linear), f"{sampler}_mscsa": float(ours)}
    return figures


ROWS = {
    "demo": Row(
        "demo clip, H.264, of a phantom that also trains the weights",
        "runs",
        "reconstruct --demo -o RUN; haustra compare RUN pipeline/demo",
        None,
        of_demo,
    ),
    "ctcolon": Row(
        "CT colon, path-traced, lossless pictures",
        "runs",
        "reconstruct CTCOLON -o RUN; haustra compare RUN CTCOLON",
        CTCOLON,
        of_ctcolon,
    ),
    "completion": Row(
        "CT colon, depth from 100 points a frame",
        "completion",
        "python -m benchmarks.completion accuracy CTCOLON",
        CTCOLON,
        of_completion,
    ),
}
HEADS = {
    "runs": "| sequence | frames posed | ATE (mm) | F-score at 1 mm (%) | precision (%) | recall (%) | commit, seeds |",
    "completion": "| depth, abs.REL (%) | exact points: linear, ours | as of SfM: linear, ours | commit, seeds |",
}


def render(record: dict[str, Any]) -> str:
    """The README's tables of a record, as Markdown."""
    parts = []
    for table, head in HEADS.items():
        lines = [head, "|" + "---|" * (head.count("|") - 1)]
        for key, row in ROWS.items():
            if row.table == table and key in record["rows"]:
                lines.append(_line(row, record["rows"][key]))
        if len(lines) > 2:
            parts.append("\n".join(lines))
    return "\n\n".join(parts)


def _line(row: Row, measured: dict[str, Any]) -> str:
    figures = measured["figures"]

    def shown(name: str, form: str) -> str:
        of = figures[name]
        middle = f"{of['median']:{form}}"
        return middle if len(of["values"]) == 1 else f"{middle} ({of['min']:{form}}-{of['max']:{form}})"

    if row.table == "runs":
        cells = [f"{shown('posed', '.0f')} of {figures['total']['median']:.0f}", shown("ate_mm", ".3f")]
        cells += [shown(name, ".1f") for name in ("f_score", "precision", "recall")]
    else:
        cells = [
            f"{shown(f'{sampler}_linear', '.1f')}, {shown(f'{sampler}_mscsa', '.1f')}" for sampler in ("uniform", "sfm")
        ]
    return "| " + " | ".join([row.name, *cells, f"{measured['commit'][:7]}, {len(measured['seeds'])}"]) + " |"


def write_readme(record: dict[str, Any]) -> None:
    """Put the tables between the README's two marks."""
    text = README.read_text()
    head, rest = text.split(BEGIN)
    README.write_text(f"{head}{BEGIN}\n\n{render(record)}\n\n{END}{rest.split(END)[1]}")


def measure_rows(keys: list[str], seeds: list[int], record: dict[str, Any], path: Path) -> None:
    """Measure what is not in the record at this commit and with these seeds, and write it after each row."""
    here = environment()
    if here["commit"].endswith("+"):
        raise SystemExit("error: the checkout has changes that no commit holds; commit them first")
    for key in keys:
        row, known = ROWS[key], record["rows"].get(key)
        if known is not None and (known["commit"], known["seeds"]) == (here["commit"], seeds):
            continue
        if row.needs is not None and not row.needs.is_dir():
            print(f"{key}: left, its data is not at {row.needs}", flush=True)
            continue
        runs = [row.measure(seed) for seed in seeds]
        figures = {name: spread([float(run[name]) for run in runs]) for name in runs[0]}
        record["rows"][key] = {"command": row.command, **here, "seeds": seeds, "figures": figures}
        path.write_text(json.dumps(record, indent=1) + "\n")
        print(_line(row, record["rows"][key]), flush=True)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--rows", nargs="+", choices=ROWS, default=list(ROWS))
    add_seeds(parser, 3)
    parser.add_argument("--render", action="store_true", help="measure nothing")


def measure(arguments: argparse.Namespace) -> None:
    """Measure, write the record after each row, and render the README, which is of the usual record alone."""
    path = arguments.json or RECORD
    record = json.loads(path.read_text()) if path.exists() else {"rows": {}}
    if not arguments.render:
        measure_rows(arguments.rows, list(range(arguments.seeds)), record, path)
    if path == RECORD:
        write_readme(record)


if __name__ == "__main__":
    run(sys.modules[__name__], "benchmarks.table")
