"""docs/lab/fusion.md from the records fusion.json and fusion_truncation.json; the words are in fusion_page.txt.

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
from pipeline.surface.fusion_stage import TRUNCATION_VOXELS
from scripts.pages.completion_page import table

RECORD, WORDS = ROOT / "benchmarks/results/fusion.json", Path(__file__).with_name("fusion_page.txt")
TRUNCATIONS = ROOT / "benchmarks/results/fusion_truncation.json"
ROLES = {"reported": "reported", "chosen": "chosen on"}


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


def truncations(runs: list[dict[str, Any]]) -> str:
    """Mean and median F at each truncation, of the films of each role."""
    rows = []
    for role, label in ROLES.items():
        mine = of_role(runs, role)
        for name, of in (("mean", statistics.fmean), ("median", statistics.median)):
            each = [of([scores[voxels]["f_score"] for scores in mine]) for voxels in mine[0]]
            rows.append([f"{label}, {len(mine)} films", name, *(f"{score:.1f}" for score in each)])
    return table(["films", "F-score, %", *(f"{voxels} voxels" for voxels in runs[0]["truncations"])], rows)


def of_role(runs: list[dict[str, Any]], role: str) -> list[dict[str, Any]]:
    """Scores by truncation, of each film of a role."""
    return [run["truncations"] for run in runs if run["method"] == role]


def gain(runs: list[dict[str, Any]], role: str) -> str:
    """What the truncation of runs changes, in place of 12 voxels, in one sentence."""
    now = f"{TRUNCATION_VOXELS:g}"
    changes = [scores[now]["f_score"] - scores["12"]["f_score"] for scores in of_role(runs, role)]
    rises, falls = (sum(sign * change > NOISE for change in changes) for sign in (1, -1))
    return (
        f"{statistics.fmean(changes):+.2f} points in the mean, {statistics.median(changes):+.2f} in the median, "
        f"{min(changes):+.2f} to {max(changes):+.2f}; it rises on {rises} of {len(changes)} films and falls on {falls}"
    )


def page() -> str:
    """The page, as committed."""
    record = json.loads(RECORD.read_text())
    about, cut = record["environment"], json.loads(TRUNCATIONS.read_text())["runs"]
    return Template(WORDS.read_text(encoding="utf-8")).substitute(
        commit=about["commit"][:7] + about["commit"][40:],
        machine=f"{about['processor']}, {about['cores']} cores",
        noise=f"{NOISE:g}",
        parts=parts(record),
        scores=scores(record),
        runs=runs(record),
        count=len(record["runs"]),
        truncation_commit=", ".join(sorted({run["commit"][:7] + run["commit"][40:] for run in cut})),
        truncations=truncations(cut),
        now=f"{TRUNCATION_VOXELS:g}",
        gain_reported=gain(cut, "reported"),
        gain_chosen=gain(cut, "chosen"),
    )


if __name__ == "__main__":
    print(page(), end="")
