"""The records of the runs, read back as tables of seeds and meshes."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common.record import ROOT
from benchmarks.paper.intervals import Interval, Table, by_mesh, mean_interval, reduction_interval

RESULTS = ROOT / "benchmarks/results/paper"
Record = dict[str, Any]


@dataclass(frozen=True)
class Records:
    """All records of a folder."""

    records: list[Record]

    @classmethod
    def read(cls, folder: Path = RESULTS) -> "Records":
        return cls([json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))])

    def of(self, scene: str, model: str, change: str = "") -> dict[int, Record]:
        """By seed, of trainings on this scene alone."""
        found = [r for r in self.records if (r["model"], r["change"], [*r["scenes"]]) == (model, change, [scene])]
        return {record["seed"]: record for record in sorted(found, key=lambda record: record["seed"])}

    def table(self, scene: str, model: str, figure: str, change: str = "", seeds: set[int] | None = None) -> Table:
        """(S,M) of a figure, of all seeds or of these; no row where there is no record."""
        runs = self.of(scene, model, change)
        frames = [run["scenes"][scene]["frames"] for seed, run in runs.items() if seeds is None or seed in seeds]
        return np.array([by_mesh(frame[figure], frame["mesh"]) for frame in frames])

    def mean(self, scene: str, model: str, figure: str, change: str = "") -> Interval | None:
        table = self.table(scene, model, figure, change)
        return mean_interval(table) if len(table) else None

    def median_frame(self, scene: str, model: str, figure: str, change: str = "") -> float | None:
        """Median over the frames of all seeds."""
        runs = self.of(scene, model, change).values()
        values = [value for run in runs for value in run["scenes"][scene]["frames"][figure]]
        return float(np.median(values)) if values else None

    def reduction(self, scene: str, model: str, beside: str, figure: str) -> tuple[Interval, int] | None:
        """By how much of `beside` a model's mean is lower, as a fraction, and of how many seeds that both have."""
        shared = self.of(scene, model).keys() & self.of(scene, beside).keys()
        if not shared:
            return None
        tables = [self.table(scene, name, figure, seeds=set(shared)) for name in (model, beside)]
        return reduction_interval(*tables), len(shared)
