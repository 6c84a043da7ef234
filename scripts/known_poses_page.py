"""docs/lab/known_poses.md from benchmarks/results/known_poses.json: surface from true poses beside its ceiling.

python scripts/known_poses_page.py > docs/lab/known_poses.md
"""

import json
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
RECORD = ROOT / "benchmarks/results/known_poses.json"

HEAD = """# True poses instead of tracking

- **Date:** 2026-11-25
- **Question:** Does `--poses` with true poses reach what completed depth can give at true poses?
- **Command:** `haustra phantom SUITE --suite`, then `python -m benchmarks.reconstruction known-poses SUITE/*
  --json benchmarks/results/known_poses.json`, on commit {commit} with changes (+), where keyframes lay 0.02 of the
  width apart (0.045 since). Rendered by
  `python scripts/known_poses_page.py > docs/lab/known_poses.md`.

F-score at 1 mm, `--fast`, lens given, one run each. `--poses`: in the run's own mm, after SE(3). Ceiling: completed
depth of the run without poses (odometry), fused with its keyframes where they truly were.

| film | `--poses` | ceiling | the run without poses | frames posed with, without |
|---|---|---|---|---|"""

READ = """
## How to read it

`--poses` is mostly above the ceiling: its points are triangulated with exact poses from SIFT features, so that the
depth which is completed from them is better too, not its place alone. On `loop`, which comes back to places that it has
seen, it is 1.3 points below. Placing the depth of odometry exactly changes little: what is lost there is depth, not
path; but on `events`, where tracking ends several times, poses join what it leaves apart.
"""


def page(record: dict[str, Any]) -> str:
    return "\n".join(
        [HEAD.replace("{commit}", record["environment"]["commit"][:7]), *(_row(run) for run in record["runs"]), READ]
    )


def _row(run: dict[str, Any]) -> str:
    if run["failed"]:
        return f"| {run['sequence']} | {_percent(run['with_poses'])} | - | - | {run['failed']} |"
    figures = (_percent(run[name]) for name in ("with_poses", "ceiling", "without"))
    posed = f"{run['posed']}, {run['tracked']} of {run['frames']}"
    return f"| {run['sequence']} | {' | '.join(figures)} | {posed} |"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f} %"


if __name__ == "__main__":
    print(page(json.loads(RECORD.read_text())), end="")
