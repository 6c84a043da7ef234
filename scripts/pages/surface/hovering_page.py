"""docs/lab/hovering.md from the record hovering.json; the words are in hovering_page.txt.

python -m scripts.pages.surface.hovering_page > docs/lab/hovering.md
"""

import json
import statistics
from pathlib import Path
from string import Template
from typing import Any

from benchmarks.common.record import ROOT
from scripts.pages.completion_page import table

RECORD, WORDS = ROOT / "benchmarks/results/hovering.json", Path(__file__).with_name("hovering_page.txt")
CHOSEN = ("hover_g", "hover_h", "hover_i", "hover_j")
VERSIONS = ("before", "now")


def rows_of(record: dict[str, Any], version: str) -> dict[str, dict[str, Any]]:
    """Figures of a version, by film."""
    mine = [run for run in record["runs"] if run["method"].startswith(f"{version},")]
    return {run["sequence"]: run for run in mine}


def films(record: dict[str, Any]) -> str:
    """A row for each film and version."""
    before, now = (rows_of(record, version) for version in VERSIONS)
    rows = []
    for film in sorted(now, key=lambda name: (name in CHOSEN, name)):
        for version, found in zip(VERSIONS, (before[film], now[film]), strict=True):
            role = "chosen on" if film in CHOSEN else "reported"
            label = [film, role] if version == "before" else ["", ""]
            rows.append([*label, version, *_figures(found)])
    head = ["film", "", "version", "posed", "map of", "ATE (mm)", "F-score (precision, recall), %", "seconds"]
    return table(head, rows)


def _figures(found: dict[str, Any]) -> list[str]:
    if found["failed"]:
        return ["none", "", "", "", f"{found['seconds']:.0f}"]
    return [
        f"{found['posed']} of {found['informative']}",
        {"odometry": "odometry", "sfm": "COLMAP"}[found["front_end"]],
        f"{found['ate_mean_mm']:.3f}",
        surface_of(found),
        f"{found['seconds']:.0f}",
    ]


def surface_of(found: dict[str, Any]) -> str:
    """F-score, precision and recall of a run, %."""
    return "{:.1f} ({:.1f}, {:.1f})".format(*(found[f"{one}_percent"] for one in ("f_score", "precision", "recall")))


def change(record: dict[str, Any], chosen: bool) -> str:
    """Change of the F-score over the films of a role; a film without a map counts as 0."""
    before, now = (rows_of(record, version) for version in VERSIONS)
    names = [name for name in now if (name in CHOSEN) == chosen]
    scores = [[rows[name]["f_score_percent"] or 0.0 for name in names] for rows in (before, now)]
    gains = [after - earlier for earlier, after in zip(*scores, strict=True)]
    means = " to ".join(f"{statistics.fmean(of):.1f}" for of in scores)
    spread = f"{min(gains):+.1f} to {max(gains):+.1f}"
    return f"mean F {means} %; change {middle_of(gains)} ({spread}), {len(names)} films"


def middle_of(gains: list[float]) -> str:
    """Median and mean of changes in points."""
    return f"{statistics.median(gains):+.1f} points in the median, {statistics.fmean(gains):+.1f} in the mean"


def costs(record: dict[str, Any]) -> str:
    """In how many films the precision falls, by how much, and how much longer a run takes at most."""
    before, now = (rows_of(record, version) for version in VERSIONS)
    both = [film for film in now if not before[film]["failed"] and not now[film]["failed"]]
    change_of = {film: now[film]["precision_percent"] - before[film]["precision_percent"] for film in both}
    falling = sorted((gain, film) for film, gain in change_of.items() if gain < 0)
    longest = max(now[film]["seconds"] - before[film]["seconds"] for film in both)
    (most, film), (least, _) = falling[0], falling[-1]
    return (
        f"precision falls in {len(falling)} of {len(both)} films, by {-least:.1f} to {-most:.1f} points (`{film}`), "
        f"and a run takes up to {longest:.0f} s longer"
    )


def page(record: dict[str, Any]) -> str:
    return Template(WORDS.read_text()).substitute(
        about(record),
        films=films(record),
        reported=change(record, chosen=False),
        chosen=change(record, chosen=True),
        costs=costs(record),
    )


def about(record: dict[str, Any]) -> dict[str, str]:
    """The commits of the versions, and the machine."""
    commits = {v: sorted({run["commit"][:7] for run in rows_of(record, v).values()}) for v in VERSIONS}
    machine = record["environment"]
    named = {version: ", ".join(found) for version, found in commits.items()}
    return named | {"machine": f"{machine['processor']}, {machine['cores']} cores"}


if __name__ == "__main__":
    print(page(json.loads(RECORD.read_text())), end="")
