"""What every benchmark writes down: commit, machine, and each figure's runs with median and spread."""

import json
import platform
import statistics
import subprocess
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]


def spread(values: list[float]) -> dict[str, Any]:
    """Median, extremes and the values themselves."""
    return {"median": statistics.median(values), "min": min(values), "max": max(values), "values": values}


def environment() -> dict[str, Any]:
    """Commit (with "+" if the tree is changed), processor, number of cores, Python."""
    git = ["git", "-C", str(ROOT)]
    commit = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True, check=False).stdout.strip()
    changed = subprocess.run([*git, "status", "--porcelain"], capture_output=True, text=True, check=False).stdout
    model = [line.split(":")[1].strip() for line in _cpuinfo() if line.startswith("model name")]
    return {
        "commit": commit + ("+" if changed.strip() else ""),
        "processor": model[0] if model else platform.processor(),
        "cores": len(model),
        "python": platform.python_version(),
    }


def _cpuinfo() -> list[str]:
    path = Path("/proc/cpuinfo")
    return path.read_text().splitlines() if path.exists() else []


def say(row: dict[str, Any], digits: int = 2) -> None:
    """Print a row on one line."""
    values = (f"{value:.{digits}f}" if isinstance(value, float) else str(value) for value in row.values())
    print("  ".join(f"{name} {value}" for name, value in zip(row, values, strict=True)), flush=True)


def write(path: Path | None, result: dict[str, Any]) -> None:
    """Write the JSON record, if a path is given."""
    if path is not None:
        path.write_text(json.dumps({"environment": environment(), **result}, indent=2) + "\n")
