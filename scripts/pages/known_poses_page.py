"""docs/lab/known_poses.md from benchmarks/results: known_poses.json, surface from true poses beside its ceiling, and
foreign_poses.json, COLMAP's model as poses and what is said of wrong ones.

python scripts/pages/known_poses_page.py > docs/lab/known_poses.md
"""

import json
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
RECORD = ROOT / "benchmarks/results/known_poses.json"
FOREIGN = ROOT / "benchmarks/results/foreign_poses.json"

HEAD = """# True poses instead of tracking

- **Date:** 2026-11-29
- **Question:** Does `--poses` with true poses reach what completed depth can give at true poses?
- **Command:** `haustra phantom SUITE --suite`, then `python -m benchmarks.reconstruction known-poses SUITE/*
  --json benchmarks/results/known_poses.json`, and `python -m benchmarks.reconstruction foreign-poses CTCOLON
  --json benchmarks/results/foreign_poses.json`, on commit {commit}. Rendered by
  `python scripts/pages/known_poses_page.py > docs/lab/known_poses.md`.

F-score at 1 mm, `--fast`, lens given, one run each. `--poses`: in the run's own mm, after SE(3). Ceiling: completed
depth of the run without poses (odometry), fused with its keyframes where they truly were.

| film | `--poses` | ceiling | the run without poses | frames posed with, without |
|---|---|---|---|---|"""

READ = """
## How to read it

`--poses` can be above the ceiling: its points are triangulated with exact poses from SIFT features, in frames at most
2.5 % of the width apart where `--fast` has 5 %, so that the depth which is completed from them is better too, not its
place alone. The least favourable film is `{worst}`, at {least:+.1f} points.
Placing the depth of odometry exactly changes little: what is lost there is depth, not path; but on
`events`, where tracking ends several times, poses join what it leaves apart.
"""


COLMAP = """
## A model of COLMAP as poses

The path-traced CT colon, lens given. For each seed `--front-end sfm`, and its sparse model given back by `--poses`. ATE
RMSE and F-score at 1 mm after Sim(3).

| seed | sfm: frames, ATE, F-score | its model as poses: frames, ATE, F-score |
|---|---|---|"""

WRONG = """
## Wrong poses

True poses of the CT colon, written as a TUM file in another reading, and what is said (exit code 1).

| poses | said |
|---|---|"""


def page(record: dict[str, Any]) -> str:
    foreign = json.loads(FOREIGN.read_text())["runs"]
    commits = sorted({run["commit"][:7] for run in [*record["runs"], *foreign]})
    wrong = [run for run in foreign if "said" in run]
    return "\n".join(
        [
            HEAD.replace("{commit}", ", ".join(commits)),
            *map(_row, record["runs"]),
            _read(record["runs"]),
            COLMAP,
            *_beside_sfm(foreign),
            WRONG,
            *(f"| {run['method']} | {run['said'] or 'nothing: the run goes on'} |" for run in wrong),
            "",
        ]
    )


def _read(runs: list[dict[str, Any]]) -> str:
    over = {run["sequence"]: run["with_poses"] - run["ceiling"] for run in runs if not run["failed"]}
    worst = min(over, key=lambda film: over[film])
    return READ.format(worst=worst, least=over[worst]).rstrip("\n")


def _beside_sfm(runs: list[dict[str, Any]]) -> list[str]:
    """A row for each seed."""
    by_seed = {(run["seed"], run["method"]): run for run in runs if "said" not in run}
    seeds = sorted({seed for seed, _ in by_seed})
    return [
        f"| {seed} | {_figures(by_seed[seed, 'sfm'])} | {_figures(by_seed[seed, 'its model as poses'])} |"
        for seed in seeds
    ]


def _figures(run: dict[str, Any]) -> str:
    return f"{run['posed']} of {run['frames']}, {run['ate_mm']:.3f} mm, {run['f']:.1f} %"


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
