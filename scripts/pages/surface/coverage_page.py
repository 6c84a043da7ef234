"""docs/lab/coverage.md from benchmarks/results/coverage.json; the words are in coverage_page.txt.

python -m scripts.pages.surface.coverage_page > docs/lab/coverage.md
"""

import json
import statistics
from itertools import chain, pairwise
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from benchmarks.common.record import ROOT
from benchmarks.coverage import RECONSTRUCT, ROLES, TRUE_DEPTH
from benchmarks.coverage_regions import fitted, loss, regions_of
from reconstruction.coverage.missed_regions import OFFSET, SLOPE, hidden_probability
from scripts.pages.completion_page import table

RECORD, WORDS = ROOT / "benchmarks/results/coverage.json", Path(__file__).with_name("coverage_page.txt")
SUITES = {  # by the folder that the record's command renders them into
    "reported": "`coverage_reported_films.yaml`",
    "suite": "the suite",
    "varied": "`coverage_varied_films.yaml`",
    "burnt": "`exposure_films.yaml`",
    "scopes": "`scope_films.yaml`",
    "choosing": "`coverage_films.yaml`",
}
SCOPES = ("reported_scope", "varied_scope", "scope_")  # films through measured colonoscopes begin with one of these
NOT_CHOSEN = ("reported", "looked at")
BINS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
FILM = ["film", "kind", "visited (mm)", "estimated (%)", "true (%)", "error (points)", "found", "false of reported"]
FILM += ["hidden wall called seen (%)", "seen wall called missed (%)"]
GROUP = [
    "films",
    "depth",
    "judged",
    "RMS error (points)",
    "mean, median",
    "worst",
    "regions found",
    "false of reported",
]


def kind(role: str) -> str:
    """As the page calls it."""
    return "chosen on" if role == "chosen" else role


def rms(rows: list[dict[str, Any]]) -> float:
    """Root mean square error in points."""
    return float(np.sqrt(np.mean([row["error_points"] ** 2 for row in rows])))


def judged(record: dict[str, Any], method: str, **wanted: str) -> list[dict[str, Any]]:
    """Rows of a method that were judged, of a suite or role."""
    rows = [row for row in record["runs"] if row["method"] == method]
    unknown = {row["suite"] for row in rows} - set(SUITES)
    assert not unknown, f"films of no suite that the page knows: {unknown}"
    return [row for row in rows if row["failed"] is None and all(row[key] == value for key, value in wanted.items())]


def not_chosen(record: dict[str, Any]) -> list[dict[str, Any]]:
    """Runs that were judged on films that nothing was chosen on: what runs are told as their error."""
    return [row for row in judged(record, RECONSTRUCT) if row["role"] in NOT_CHOSEN]


def through_scopes(record: dict[str, Any]) -> list[dict[str, Any]]:
    """Of these, the films through lenses of measured colonoscopes."""
    return [row for row in not_chosen(record) if row["sequence"].startswith(SCOPES)]


def films(record: dict[str, Any], method: str) -> str:
    """A row for each film, suite by suite."""
    rows = [_film(row) for suite in SUITES for row in judged(record, method, suite=suite)]
    failed = [row for row in record["runs"] if row["method"] == method and row["failed"] is not None]
    rows += [[row["sequence"], kind(row["role"]), f"not judged: {row['failed']}", *[""] * 7] for row in failed]
    return table(FILM, rows)


def _film(row: dict[str, Any]) -> list[str]:
    return [
        row["sequence"],
        kind(row["role"]),
        f"{row['visited_mm']:.0f}",
        f"{row['estimated_percent']:.1f}",
        f"{row['true_percent']:.1f}",
        f"{row['error_points']:+.1f}",
        f"{row['found']} of {row['true_regions']}",
        f"{row['false']} of {row['reported_regions']}",
        f"{row['hidden_called_seen_percent']:.0f}",
        f"{row['seen_called_missed_percent']:.0f}",
    ]


def summary(record: dict[str, Any]) -> str:
    """A row for each group of films and method."""
    groups = {
        "reported": judged(record, RECONSTRUCT, role="reported"),
        "looked at": judged(record, RECONSTRUCT, role="looked at"),
        "both": not_chosen(record),
        "of both, through measured colonoscopes": through_scopes(record),
        "chosen on": judged(record, RECONSTRUCT, role="chosen"),
    }
    for suite in ("suite", "varied", "burnt", "scopes"):
        groups[f"of those looked at, {SUITES[suite]}"] = judged(record, RECONSTRUCT, suite=suite)
    rows = [[words, "run", *_errors(found)] for words, found in groups.items()]
    true = {words: judged(record, TRUE_DEPTH, suite=suite) for suite, words in SUITES.items()}
    return table(GROUP, rows + [[words, "true", *_errors(found)] for words, found in true.items() if found])


def _errors(rows: list[dict[str, Any]]) -> list[str]:
    error = [row["error_points"] for row in rows]
    true, found, reported, false = (
        sum(row[key] for row in rows) for key in ("true_regions", "found", "reported_regions", "false")
    )
    middle = f"{statistics.fmean(error):+.1f}, {statistics.median(error):+.1f}"
    worst = f"{max(error, key=abs):+.1f}"
    return [str(len(rows)), f"{rms(rows):.1f}", middle, worst, f"{found} of {true}", f"{false} of {reported}"]


def reliability(record: dict[str, Any]) -> str:
    """Regions by the probability that was said, and how many of them were hidden."""
    by_role = {role: regions_of(record, role) for role in ROLES}
    names = [[f"{kind(role)}: regions", "of these hidden (%)"] for role in by_role]
    rows = []
    for low, high in pairwise(BINS):
        rows.append([f"{100 * low:.0f} to {100 * high:.0f}"])
        for reach, is_true in by_role.values():
            told = hidden_probability(reach)
            inside = (told >= low) & (told < high)
            rows[-1] += [str(inside.sum()), f"{100 * is_true[inside].mean():.0f}" if inside.any() else "-"]
    return table(["probability said (%)", *chain.from_iterable(names)], rows)


def page() -> str:
    """The page, as committed."""
    record = json.loads(RECORD.read_text())
    reach, is_true = regions_of(record, "reported")
    told = hidden_probability(reach)
    about, likely, reported = record["environment"], told > 0.5, judged(record, RECONSTRUCT, role="reported")
    area, beyond = [row["area_of_true"] for row in reported], not_chosen(record)
    chosen_regions = regions_of(record, "chosen")
    sigma = fitted(*chosen_regions)[1]
    asked = [row for row in record["runs"] if row["method"] == RECONSTRUCT and row["role"] in NOT_CHOSEN]
    return Template(WORDS.read_text(encoding="utf-8")).substitute(
        commit=", ".join(sorted({row["commit"][:7] + row["commit"][40:] for row in record["runs"]})),
        machine=f"{about['processor']}, {about['cores']} cores",
        summary=summary(record),
        end_to_end=films(record, RECONSTRUCT),
        true_depth=films(record, TRUE_DEPTH),
        reliability=reliability(record),
        regions=len(reach),
        loss=f"{loss(told, is_true):.3f}",
        base=f"{loss(np.full(len(reach), is_true.mean()), is_true):.3f}",
        likely=f"{likely.sum()}, of which {(~is_true[likely]).sum()} are false",
        unlikely=f"{(~likely).sum()}, of which {is_true[~likely].sum()} are hidden",
        offset=f"{OFFSET:.2f} (standard error {sigma[0]:.1f})",
        slope=f"{SLOPE:.2f} (standard error {sigma[1]:.1f})",
        fitted_regions=len(chosen_regions[0]),
        said=f"{100 * told.mean():.0f}",
        true=f"{100 * is_true.mean():.0f}",
        chosen_rms=f"{rms(judged(record, RECONSTRUCT, role='chosen')):.1f}",
        reported_rms=f"{rms(reported):.1f}",
        both_rms=f"{rms(beyond):.1f}",
        over=sum(abs(row["error_points"]) > rms(beyond) for row in beyond),
        judged=f"{len(beyond)} of {len(asked)}",
        scopes=len(through_scopes(record)),
        scope_mean=f"{-statistics.fmean(row['error_points'] for row in through_scopes(record)):.1f}",
        count=len([row for row in asked if row["role"] == "reported"]),
        looked=len([row for row in asked if row["role"] == "looked at"]),
        least_area=f"{100 * min(area):.0f}",
        most_area=f"{100 * max(area):.0f} %",
    )


if __name__ == "__main__":
    print(page(), end="")
