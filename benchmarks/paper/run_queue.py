"""Train and judge the rows of the paper's tables, one after the other; a stopped queue goes on where it was.

    python -m benchmarks.paper --work WORK                # all tables
    python -m benchmarks.paper --work WORK --table 2      # one of them

Prints first what is left to do. Renders into WORK the frames that are not there, keeps checkpoints and weights there,
and writes one JSON file for each run, with commit and machine, to benchmarks/results/paper; runs that have theirs are
left out. One thread.
"""

import argparse
import json
import os
from pathlib import Path

from benchmarks.common.record import ROOT, environment
from benchmarks.paper.plan import UNTRAINED, Run, tables

RESULTS = ROOT / "benchmarks/results/paper"
SECONDS_A_STEP = 0.4  # of processor, before any run has been measured


def budget(runs: list[Run], results: Path) -> str:
    """Trainings that are left and their processor time, from the mean of those that are done."""
    done = [json.loads(path.read_text()) for path in results.glob("*.json")]
    timed = [seconds for record in done if (seconds := record["processor_seconds_a_step"])]
    seconds = sum(timed) / len(timed) if timed else SECONDS_A_STEP
    left = sum(run.steps for run in runs if run.model not in UNTRAINED)
    return f"{len(runs)} runs left, {left} steps of 10 frames, {left * seconds / 3600:.1f} processor hours"


def main() -> None:
    parser = argparse.ArgumentParser(
        "python -m benchmarks.paper", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    known = tables()
    parser.add_argument("--work", type=Path, required=True, help="folder of frames, checkpoints and weights")
    parser.add_argument("--table", choices=known, action="append", help="only this; again for more")
    parser.add_argument("--results", type=Path, default=RESULTS, help="folder of the records")
    arguments = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    from benchmarks.paper.single_run import perform  # after the number of threads is settled

    arguments.results.mkdir(parents=True, exist_ok=True)
    here = environment()  # once: a run does not change the commit of the next
    chosen = [run for name in arguments.table or known for run in known[name].runs]
    runs = [run for run in chosen if not (arguments.results / f"{run.name}.json").exists()]
    print(budget(runs, arguments.results), flush=True)
    for run in runs:
        record = perform(run, arguments.work, here)
        (arguments.results / f"{run.name}.json").write_text(json.dumps(record) + "\n")
        figures = {scene: sum(f := of["frames"]["abs_rel"]) / len(f) for scene, of in record["scenes"].items()}
        print(run.name, {scene: f"{100 * value:.2f} %" for scene, value in figures.items()}, flush=True)
