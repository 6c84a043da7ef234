"""docs/lab/coverage.md from benchmarks/results/coverage.json; the words are in coverage_page.txt.

python -m scripts.pages.surface.coverage_page > docs/lab/coverage.md
"""

import json
import statistics
from itertools import pairwise
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from benchmarks.common.record import ROOT
from benchmarks.coverage import RECONSTRUCT, ROLES, TRUE_DEPTH
from benchmarks.coverage_regions import fitted, loss, regions_of
from reconstruction.coverage.missed_regions import OFFSET, SLOPE, hidden_probability

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
HEAD = (
    "| film | kind | visited (mm) | estimated (%) | true (%) | error (points) | found | false of reported | hidden "
    "wall called seen (%) | seen wall called missed (%) |\n" + "|---" * 10 + "|"
)


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
    lines = [HEAD]
    for suite in SUITES:
        lines += [_film(row) for row in judged(record, method, suite=suite)]
    failed = [row for row in record["runs"] if row["method"] == method and row["failed"] is not None]
    lines += [f"| {row['sequence']} | {row['role']} | not judged: {row['failed']} |{' |' * 7}" for row in failed]
    return "\n".join(lines)


def _film(row: dict[str, Any]) -> str:
    cells = [row["sequence"], row["role"].replace("chosen", "chosen on"), f"{row['visited_mm']:.0f}"]
    cells += [f"{row['estimated_percent']:.1f}", f"{row['true_percent']:.1f}", f"{row['error_points']:+.1f}"]
    cells += [f"{row['found']} of {row['true_regions']}", f"{row['false']} of {row['reported_regions']}"]
    cells += [f"{row['hidden_called_seen_percent']:.0f}", f"{row['seen_called_missed_percent']:.0f}"]
    return f"| {' | '.join(cells)} |"


def summary(record: dict[str, Any]) -> str:
    """A row for each group of films and method."""
    lines = [
        "| films | depth | judged | RMS error (points) | mean, median | worst | regions found | false of reported |",
        "|---" * 8 + "|",
    ]
    groups = {
        "reported": judged(record, RECONSTRUCT, role="reported"),
        "looked at": judged(record, RECONSTRUCT, role="looked at"),
        "both": not_chosen(record),
        "of both, through measured colonoscopes": through_scopes(record),
        "chosen on": judged(record, RECONSTRUCT, role="chosen"),
    }
    for suite in ("suite", "varied", "burnt", "scopes"):
        groups[f"of those looked at, {SUITES[suite]}"] = judged(record, RECONSTRUCT, suite=suite)
    lines += [f"| {words} | run | {len(rows)} | {_errors(rows)} |" for words, rows in groups.items()]
    for suite, words in SUITES.items():
        if rows := judged(record, TRUE_DEPTH, suite=suite):
            lines.append(f"| {words} | true | {len(rows)} | {_errors(rows)} |")
    return "\n".join(lines)


def _errors(rows: list[dict[str, Any]]) -> str:
    error = [row["error_points"] for row in rows]
    true, found, reported, false = (
        sum(row[key] for row in rows) for key in ("true_regions", "found", "reported_regions", "false")
    )
    middle = f"{statistics.fmean(error):+.1f}, {statistics.median(error):+.1f}"
    return f"{rms(rows):.1f} | {middle} | {max(error, key=abs):+.1f} | {found} of {true} | {false} of {reported}"


def reliability(record: dict[str, Any]) -> str:
    """Regions by the probability that was said, and how many of them were hidden."""
    by_role = {role: regions_of(record, role) for role in ROLES}
    names = [f"{role.replace('chosen', 'chosen on')}: regions | of these hidden (%)" for role in by_role]
    lines = [f"| probability said (%) | {' | '.join(names)} |", "|---" * 7 + "|"]
    for low, high in pairwise(BINS):
        cells = [f"{100 * low:.0f} to {100 * high:.0f}"]
        for reach, is_true in by_role.values():
            told = np.array([hidden_probability(one) for one in reach])
            inside = (told >= low) & (told < high)
            cells += [str(inside.sum()), f"{100 * is_true[inside].mean():.0f}" if inside.any() else "-"]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def page() -> str:
    """The page, as committed."""
    record = json.loads(RECORD.read_text())
    reach, is_true = regions_of(record, "reported")
    told = np.array([hidden_probability(one) for one in reach])
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
