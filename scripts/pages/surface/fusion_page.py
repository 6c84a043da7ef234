"""docs/lab/fusion.md from benchmarks/results/fusion.json; the words are in fusion_page.txt.

python -m scripts.pages.surface.fusion_page > docs/lab/fusion.md
"""

import json
import statistics
from pathlib import Path
from string import Template
from typing import Any

from benchmarks.common.record import ROOT
from benchmarks.fusion.comparison import NOISE, PARTS, cell
from benchmarks.fusion.measured_run import VARIANTS

RECORD, WORDS = ROOT / "benchmarks/results/fusion.json", Path(__file__).with_name("fusion_page.txt")


def runs(record: dict[str, Any]) -> str:
    """A row for each run and depth, a column for each part that is on."""
    lines = [f"| film (frames posed) | depth | {' | '.join(VARIANTS)} |", "|---" * (2 + len(VARIANTS)) + "|"]
    for name, depths in record["runs"].items():
        about = record["about"][name]
        for row, (depth, columns) in enumerate(depths.items()):
            label = f"{name} ({about['posed']} of {about['film']})" if row == 0 else ""
            cells = [cell(columns[variant]) if variant in columns else "" for variant in VARIANTS]
            lines.append(f"| {label} | {depth} | {' | '.join(cells)} |")
    return "\n".join(lines)


def parts(record: dict[str, Any]) -> str:
    """What each part changes, by depth."""
    lines = ["| part | depth | median (least to most) | rises in | falls in | of |", "|---" * 6 + "|"]
    for part in list(PARTS)[:-1]:  # but the pose graph: docs/lab/loop_closing.md
        for depth, found in record["summary"].get(part, {}).items():
            spread = f"{found['median']:+.1f} ({found['min']:+.1f} to {found['max']:+.1f})"
            lines.append(f"| {part} | {depth} | {spread} | {found['helps']} | {found['hurts']} | {found['runs']} |")
    return "\n".join(lines)


def scores(record: dict[str, Any]) -> str:
    """F of each depth with all its parts: mean, median, least."""
    lines = ["| depth | mean | median | least |", "|---|---|---|---|"]
    for depth in next(iter(record["runs"].values())):
        found = [100 * _fullest(depths[depth])["f_score"] for depths in record["runs"].values()]
        least, mean, middle = min(found), statistics.fmean(found), statistics.median(found)
        lines.append(f"| {depth} | {mean:.1f} | {middle:.1f} | {least:.1f} |")
    return "\n".join(lines)


def _fullest(columns: dict[str, Any]) -> dict[str, Any]:
    return dict([figures for name in VARIANTS if (figures := columns.get(name))][-1])


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
