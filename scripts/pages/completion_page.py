"""docs/lab/completion.md from benchmarks/results/completion_*.json; the words are in completion_page.txt.

python -m scripts.pages.completion_page > docs/lab/completion.md
"""

import json
from pathlib import Path
from statistics import mean, median, stdev
from string import Template
from typing import Any

from benchmarks.common.record import ROOT, shown
from completion.inference.resolution import SIDE_FOR_MANY

RESULTS, WORDS = ROOT / "benchmarks/results", Path(__file__).with_name("completion_page.txt")
RECORDS = ("accuracy", "sizes", "mesh_sizes", "precision", "points", "speed")
FOLDERS = {"ctcolon": "CT colon", "simcol3d": "SimCol3D"}
SAMPLERS = {"uniform": "uniform", "sfm": "SfM-like", "features": "exact at keypoints"}
CASES = {
    "as_drawn": "as drawn: 3 % noise, 3 % outliers",
    "noise_told": "as drawn, given the noise",
    "told": "as drawn, given the noise and which are outliers (by the truth)",
    "no_outliers": "outliers made exact",
    "no_noise": "noise taken out",
    "exact": "both",
}


def table(columns: list[str], rows: list[list[str]]) -> str:
    """A Markdown table."""
    lines = [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]
    return "\n".join(lines + [f"| {' | '.join(row)} |" for row in rows])


def drawn(row: dict[str, Any]) -> str:
    return f"{row['points']:,} {SAMPLERS[row['sampler']]}"


def accuracy(record: dict[str, Any]) -> str:
    """The shipped model beside linear interpolation."""
    rows = []
    for row in record["rows"]:
        cells = [FOLDERS[row["folder"]], drawn(row), str(row["frames"])]
        for name in ("linear", "mscsa"):
            of = {key.removeprefix(f"{name}_"): value for key, value in row.items() if key.startswith(f"{name}_")}
            spread = f"{of['abs_rel_percent']:.2f} ({of['least']:.2f}-{of['most']:.2f})"
            cells += [spread, f"{of['median']:.2f}", f"{of['over_10']:.0f}"]
        rows.append(cells)
    columns = ["frames of", "points", "frames", "linear", "median", "over 10 %", "`mscsa`", "median", "over 10 %"]
    return table(columns, rows)


def variants(record: dict[str, Any], name: str) -> str:
    """A row for each setting of the points, a column for each variant of the model."""
    columns = list(dict.fromkeys(_variant(row, name) for row in record["rows"]))
    found: dict[str, dict[str, str]] = {}
    for row in record["rows"]:
        paired = f" ({row['paired_error']:.2f})" if _variant(row, name) != columns[0] else ""
        cell = f"{row['abs_rel_percent']:.2f}{paired}"
        found.setdefault(f"{drawn(row)}, {row['frames']} frames", {})[_variant(row, name)] = cell
    return table(["points", *columns], [[name, *(cells[c] for c in columns)] for name, cells in found.items()])


def _variant(row: dict[str, Any], name: str) -> str:
    if name == "precision":
        return str(row["precision"])
    return f"{row['size_px']} px, {row['iterations']} iteration{'s' * (row['iterations'] > 1)}"


def mesh_sizes(record: dict[str, Any]) -> str:
    """F-score of each film by the size, in percent; then what the size that is taken has over each other one."""
    found: dict[str, dict[str, float]] = {}
    for run in record["runs"]:
        found.setdefault(run["sequence"], {})[run["method"]] = run["f_score"]
    sizes, taken = list(next(iter(found.values()))), f"{SIDE_FOR_MANY} px"
    rows = [[film, *(f"{of[size]:.2f}" for size in sizes)] for film, of in found.items()]
    lines = [table(["film", *sizes], rows), ""]
    for other in sizes:
        more = [of[taken] - of[other] for of in found.values()]
        if other != taken:
            about = f"{mean(more):+.2f} +- {stdev(more) / len(more) ** 0.5:.2f} points in the mean, {median(more):+.2f}"
            higher = f"higher on {sum(m > 0 for m in more)} of {len(more)} films"
            lines.append(
                f"- {taken} less {other}: {about} in the median, {min(more):+.2f} to {max(more):+.2f}; {higher}."
            )
    return "\n".join(lines)


def points(record: dict[str, Any]) -> str:
    """The cases of the points' errors."""
    rows, order = [], list(CASES)
    for row in sorted(record["rows"], key=lambda row: order.index(row["case"])):
        paired = f" ({row['paired_error']:.2f})" if row["case"] != "as_drawn" else ""
        cells = [f"{row['abs_rel_percent']:.2f}{paired}", f"{row['within_percent']:.0f} %"]
        rows.append([CASES[row["case"]], *cells])
    return table(["points", "abs.REL [%]", "below predicted"], rows)


def speed(record: dict[str, Any]) -> str:
    """Every call that was timed."""
    return table(["call", "ms"], [[name, shown(of, ".0f")] for name, of in record["figures"].items()])


def page() -> str:
    """The whole page."""
    read = {name: json.loads((RESULTS / f"completion_{name}.json").read_text()) for name in RECORDS}
    about = {name: record["environment"] for name, record in read.items()}
    commits = ", ".join(sorted({of["commit"][:7] for of in about.values()}))
    machine = ", ".join(sorted({f"{of['processor']}, {of['cores']} cores" for of in about.values()}))
    parts = {
        "provenance": f"Commits {commits}; {machine}; {read['accuracy']['precision']} unless said otherwise.",
        "accuracy": accuracy(read["accuracy"]),
        "sizes": variants(read["sizes"], "size"),
        "mesh_sizes": mesh_sizes(read["mesh_sizes"]),
        "precision": variants(read["precision"], "precision"),
        "points": points(read["points"]),
        "speed": speed(read["speed"]),
    }
    return Template(WORDS.read_text(encoding="utf-8")).substitute(parts)


if __name__ == "__main__":
    print(page(), end="")
