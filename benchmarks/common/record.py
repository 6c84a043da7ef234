"""What every benchmark prints and writes down: commit, machine, and each figure's runs with median and spread."""

import json
import os
import platform
import statistics
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from reconstruction.evaluation.surface_metrics import SurfaceErrors

ROOT = Path(__file__).parents[2]


def spread(values: list[float]) -> dict[str, Any]:
    """Median, extremes and the values themselves."""
    return {"median": statistics.median(values), "min": min(values), "max": max(values), "values": values}


def shown(of: dict[str, Any], form: str = ".4g") -> str:
    """A spread in one line: median [least, most]."""
    return f"{of['median']:{form}} [{of['min']:{form}}, {of['max']:{form}}]"


def environment(checkout: Path = ROOT) -> dict[str, Any]:
    """Commit of a checkout (with "+" if its tree is changed elsewhere than in the records, the README and the pages of
    docs/lab, which show them), processor, number of cores, Python.

    Where a tree was copied to another machine, whoever copied it names its commit in the variable HAUSTRA_COMMIT.
    """
    git = ["git", "-C", str(checkout)]
    commit = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True, check=False).stdout.strip()
    changed = subprocess.run(
        [*git, "status", "--porcelain", "--", ".", ":!benchmarks/results", ":!README.md", ":!docs/lab"],
        capture_output=True,
        text=True,
        check=False,
    ).stdout
    model = [line.split(":")[1].strip() for line in _cpuinfo() if line.startswith("model name")]
    return {
        "commit": os.environ.get("HAUSTRA_COMMIT") or commit + ("+" if changed.strip() else ""),
        "processor": model[0] if model else platform.processor(),
        "cores": len(model),
        "python": platform.python_version(),
    }


def _cpuinfo() -> list[str]:
    path = Path("/proc/cpuinfo")
    return path.read_text().splitlines() if path.exists() else []


def in_percent(surface: "SurfaceErrors") -> dict[str, float]:
    """F-score, precision and recall of a surface."""
    return {name: 100 * getattr(surface, name) for name in ("f_score", "precision", "recall")}


def print_row(row: dict[str, Any], digits: int = 2) -> None:
    """Names and values on one line."""
    values = (f"{value:.{digits}f}" if isinstance(value, float) else str(value) for value in row.values())
    print("  ".join(f"{name} {value}" for name, value in zip(row, values, strict=True)), flush=True)


def print_figures(figures: dict[str, float]) -> None:
    """One figure on a line."""
    width = max(map(len, figures))
    for name, value in figures.items():
        print(f"{name:{width}} {value:.4g}")


def write(path: Path | None, result: dict[str, Any]) -> None:
    """Write the JSON record, if a path is given."""
    if path is not None:
        path.write_text(json.dumps({"environment": environment(), **result}, indent=2) + "\n")


class RunTable:
    """Runs of several methods on several sequences, one for each seed: `{"runs": [{sequence, seed, method, ...}]}`.

    Every run is written down as it ends, with its commit, so that a stopped call goes on where it was: rows that the
    file has already are kept. Without a path nothing is written.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self.runs: list[dict[str, Any]] = []
        if path is not None and path.exists():
            self.runs = json.loads(path.read_text())["runs"]

    def has(self, sequence: str, seed: int, method: str) -> bool:
        return any((r["sequence"], r["seed"], r["method"]) == (sequence, seed, method) for r in self.runs)

    def add(self, sequence: str, seed: int, by_method: dict[str, dict[str, Any]]) -> None:
        """Enter the figures of each method and write the whole table."""
        about = {"sequence": sequence, "seed": seed, "commit": environment()["commit"]}
        self.runs += [about | {"method": method} | figures for method, figures in by_method.items()]
        if by_method:
            write(self.path, {"runs": self.runs})

    def of(self, sequence: str, method: str) -> list[dict[str, Any]]:
        """The runs of one sequence and method."""
        return [r for r in self.runs if (r["sequence"], r["method"]) == (sequence, method)]
