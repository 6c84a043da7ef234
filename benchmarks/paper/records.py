"""The records of the runs, read back as tables of seeds and meshes."""

import json
from collections import defaultdict
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common.record import ROOT
from benchmarks.paper.intervals import Interval, Table, by_mesh, mean_interval, reduction_interval
from benchmarks.paper.plan import SIZE, Run

RESULTS = ROOT / "benchmarks/results/paper"
AGAIN = ROOT / "benchmarks/results/paper_again"  # of trainings made a second time, on another machine
FIGURES = ROOT / "benchmarks/results/paper_figures.json"  # of `benchmarks.paper.figures`
Record = dict[str, Any]
Row = tuple[Any, ...]
LATER: Record = {"side": SIZE}  # of records that do not name it
ROW = tuple(field.name for field in fields(Run) if field.name not in ("seed", "scenes"))  # what runs of a row share


@dataclass(frozen=True)
class Records:
    """All records of a folder. A row of a table is asked for by one of its runs, of whatever seed; a figure by the
    scene that it was judged on."""

    records: list[Record]

    @classmethod
    def read(cls, folder: Path = RESULTS) -> "Records":
        return cls([json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))])

    def of(self, run: Run) -> dict[int, Record]:
        """By seed, but for trainings that came to nothing."""
        found = [record for record in self._of_row(run) if not record["failed"]]
        return {record["seed"]: record for record in sorted(found, key=lambda record: record["seed"])}

    def failed(self, run: Run) -> int:
        """Trainings that came to nothing."""
        return sum(bool(record["failed"]) for record in self._of_row(run))

    def table(self, scene: str, run: Run, figure: str, seeds: set[int] | None = None) -> Table:
        """(S,M) of a figure, of all seeds or of these; no row where there is no record."""
        runs = self.of(run)
        frames = [found["scenes"][scene]["frames"] for seed, found in runs.items() if seeds is None or seed in seeds]
        return np.array([by_mesh(frame[figure], frame["mesh"]) for frame in frames])

    def mean(self, scene: str, run: Run, figure: str) -> Interval | None:
        table = self.table(scene, run, figure)
        return mean_interval(table) if len(table) else None

    def median_frame(self, scene: str, run: Run, figure: str) -> float | None:
        """Median over the frames of all seeds."""
        values = [value for found in self.of(run).values() for value in found["scenes"][scene]["frames"][figure]]
        return float(np.median(values)) if values else None

    def reduction(self, scene: str, run: Run, beside: Run, figure: str) -> tuple[Interval, int] | None:
        """By how much of `beside` a row's mean is lower, as a fraction, and of how many seeds that both have."""
        tables = self.pair(scene, run, beside, figure)
        return (reduction_interval(*tables), len(tables[0])) if tables else None

    def pair(self, scene: str, run: Run, beside: Run, figure: str) -> tuple[Table, Table] | None:
        """Tables of two rows, of the seeds that both have; None without such a seed."""
        shared = set(self.of(run).keys() & self.of(beside).keys())
        first, second = (self.table(scene, which, figure, shared) for which in (run, beside))
        return (first, second) if shared else None

    def _of_row(self, run: Run) -> list[Record]:
        return self._by_row.get(row_of_run(run), [])

    @cached_property
    def _by_row(self) -> dict[Row, list[Record]]:
        rows = defaultdict(list)
        for record in self.records:
            rows[row_of_record(record)].append(record)
        return rows


def row_of_run(run: Run) -> Row:
    """What it shares with the records of its row: all but the seed."""
    return (*(getattr(run, name) for name in ROW), *run.scenes)


def row_of_record(record: Record) -> Row:
    """The same of a record."""
    return (*((LATER | record)[name] for name in ROW), *record["frames_digest"])
