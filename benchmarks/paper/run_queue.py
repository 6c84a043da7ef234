"""Train and judge the rows of the paper's tables; a stopped queue goes on where it was.

    python -m benchmarks.paper --work WORK                # all tables
    python -m benchmarks.paper --work WORK --table 2      # one of them
    python -m benchmarks.paper --work WORK --workers 12   # so many runs at once, as suits a GPU

Prints first what is left to do. Renders into WORK the scenes that are not there, keeps checkpoints and weights there,
and writes one JSON file for each run, with commit and machine, to benchmarks/results/paper; runs that have theirs are
left out, and a run that was stopped goes on from its checkpoint. One thread a run, on the GPU where there is one.
"""

import argparse
import json
import multiprocessing
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.common.record import environment
from benchmarks.paper.plan import UNTRAINED, Run, tables, unique
from benchmarks.paper.records import RESULTS


def budget(runs: list[Run], results: Path) -> str:
    """Trainings that are left, and what a step took in those that are recorded, by machine."""
    taken: dict[str, list[float]] = {}
    records = [json.loads(path.read_text()) for path in results.glob("*.json")]
    for record in records:
        if seconds := record["seconds_a_step"]:
            taken.setdefault(record["environment"].get("gpu") or record["environment"]["processor"], []).append(seconds)
    paces = "; ".join(f"{sum(of) / len(of):.2g} s a step on {machine}" for machine, of in taken.items())
    left = sum(run.steps for run in runs if run.model not in UNTRAINED)
    if not runs:
        return f"all of these runs are recorded in {results}; python -m scripts.pages.paper.page prints their page"
    text = f"{len(runs)} runs have no record in {results}: at most {left:,} steps of 10 frames"
    return text + (f" (recorded: {paces}, several at once on a GPU)" if paces else "")


def main() -> None:
    known = tables()
    titles = "; ".join(f"{name}: {table.title}" for name, table in known.items())
    parser = argparse.ArgumentParser(
        "python -m benchmarks.paper", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--work", type=Path, required=True, help="folder of frames, checkpoints and weights")
    parser.add_argument(
        "--table", choices=known, action="append", help=f"only this; may be given several times; {titles}"
    )
    parser.add_argument("--results", type=Path, default=RESULTS, help="the records; runs that have one are left out")
    parser.add_argument("--list", action="store_true", help="only say what is left to do")
    parser.add_argument("--workers", type=int, default=1, help="runs at once")
    arguments = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    from benchmarks.paper.frames import render  # after the number of threads is settled

    arguments.results.mkdir(parents=True, exist_ok=True)
    chosen = unique([run for name in arguments.table or known for run in known[name].runs])
    runs = [run for run in chosen if not (arguments.results / f"{run.name}.json").exists()]
    print(budget(runs, arguments.results), flush=True)
    if arguments.list:
        print("\n".join(f"{run.name}: at most {run.steps:,} steps" for run in runs))
        return
    # The environment is read once: a run does not change the commit of the next.
    record = partial(perform_and_record, work=arguments.work, results=arguments.results, environment=environment())
    try:
        for scene, side in dict.fromkeys((scene, run.side) for run in runs for scene in run.scenes):
            render(arguments.work, scene, side)
        perform_all(record, runs, arguments.workers)
    except KeyboardInterrupt:
        raise SystemExit("stopped; the same command goes on after the last meshes and checkpoints") from None


def perform_all(record: Callable[[Run], str], runs: list[Run], workers: int) -> None:
    """All runs, so many at once, but one after the other those that share weights; says what came of each."""
    sharing: dict[str, list[Run]] = {}
    for run in runs:
        sharing.setdefault(run.weights, []).append(run)
    one_by_one = partial(map_all, record)
    if workers == 1:
        for lines in map(one_by_one, sharing.values()):
            print(*lines, sep="\n", flush=True)
        return
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        for lines in pool.imap_unordered(one_by_one, sharing.values()):
            print(*lines, sep="\n", flush=True)


def map_all(record: Callable[[Run], str], runs: list[Run]) -> list[str]:
    """What came of each run, in their order."""
    return [record(run) for run in runs]


def perform_and_record(run: Run, work: Path, results: Path, environment: dict[str, Any]) -> str:
    """Write the record of a run; returns its name and mean abs.REL by scene."""
    import torch

    from benchmarks.paper.single_run import perform

    gpu = {"gpu": torch.cuda.get_device_name()} if torch.cuda.is_available() else {}
    record = perform(run, work, environment | gpu)
    (results / f"{run.name}.json").write_text(json.dumps(record) + "\n")
    figures = {scene: sum(f := of["frames"]["abs_rel"]) / len(f) for scene, of in record["scenes"].items()}
    return f"{run.name} { ({scene: f'{100 * value:.2f} %' for scene, value in figures.items()}) }"
