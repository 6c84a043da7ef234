"""The README's table of figures says what its record says."""

import json
from pathlib import Path

ROOT = Path(__file__).parents[1]
RUNS = json.loads((ROOT / "benchmarks/results/accuracy.json").read_text())["runs"]


def test_every_run_of_the_record_is_in_the_readme_with_its_figures():
    rows = [line for line in (ROOT / "README.md").read_text().splitlines() if line.startswith("| ")]
    for name, run in RUNS.items():
        (row,) = [row for row in rows if row.startswith(f"| {name}")]
        percent = " | ".join(f"{100 * run[key]:.1f}" for key in ("f_score", "precision", "recall"))
        assert f"| {run['posed']} of {run['total']} | {run['ate_mm']:.3f} | {percent} |" in row
