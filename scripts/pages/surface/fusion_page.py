"""docs/lab/fusion.md from benchmarks/results/fusion.json; the words are in fusion_page.txt.

python -m scripts.pages.surface.fusion_page > docs/lab/fusion.md
"""

import json
import statistics
from pathlib import Path
from string import Template
from typing import Any

from benchmarks.common.record import ROOT
from benchmarks.fusion.comparison import NOISE, PARTS, cell, fullest
from benchmarks.fusion.measured_run import VARIANTS
from scripts.pages.completion_page import table

RECORD, WORDS = ROOT / "benchmarks/results/fusion.json", Path(__file__).with_name("fusion_page.txt")


def runs(record: dict[str, Any]) -> str:
    """A row for each run and depth, a column for each part that is on."""
    rows = []
    for name, depths in record["runs"].items():
        about = record["about"][name]
        label = f"{name} ({about['posed']} of {about['film']})"
        for depth, columns in depths.items():
            rows.append([label, depth, *(cell(columns[part]) if part in columns else "" for part in VARIANTS)])
            label = ""
    return table(["film (frames posed)", "depth", *VARIANTS], rows)


def parts(record: dict[str, Any]) -> str:
    """What each part changes, by depth."""
    rows = []
    for part in list(PARTS)[:-1]:  # but the pose graph: docs/lab/loop_closing.md
        for depth, found in record["summary"].get(part, {}).items():
            spread = f"{found['median']:+.1f} ({found['min']:+.1f} to {found['max']:+.1f})"
            rows.append([part, depth, spread, *(str(found[count]) for count in ("helps", "hurts", "runs"))])
    return table(["part", "depth", "median (least to most)", "rises in", "falls in", "of"], rows)


def scores(record: dict[str, Any]) -> str:
    """F of each depth with all its parts: mean, median, least."""
    rows = []
    for depth in next(iter(record["runs"].values())):
        found = [100 * depths[depth][fullest(depths[depth])]["f_score"] for depths in record["runs"].values()]
        rows.append([depth, *(f"{of(found):.1f}" for of in (statistics.fmean, statistics.median, min))])
    return table(["depth", "mean", "median", "least"], rows)


def page() -> str:
    """The page, as committed."""
    record = json.loads(RECORD.read_text())
    about = record["environment"]
    return Template(WORDS.read_text(encoding="utf-8")).substitute(
        commit=about["commit"][:7] + about["commit"][40:],
        machine=f"{about['processor']}, {about['cores']} cores",
        noise=f"{NOISE:g}",
        parts=parts(record),
        scores=scores(record),
        runs=runs(record),
        count=len(record["runs"]),
    )


if __name__ == "__main__":
    print(page(), end="")
