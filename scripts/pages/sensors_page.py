"""docs/lab/sensors.md from benchmarks/results/sensors.json: what each part of a sensor's use gives.

python scripts/pages/sensors_page.py > docs/lab/sensors.md
"""

import json
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
RECORD = ROOT / "benchmarks/results/sensors.json"

HEAD = """# Depth sensors and second eyes, part by part

- **Date:** 2026-11-27
- **Question:** What do a time-of-flight sensor and a second eye give to scale, path and surface, and by which part?
- **Command:** `haustra phantom SUITE --suite`, then `python -m benchmarks.reconstruction sensors SUITE/easy_withdrawal
  --parts --json benchmarks/results/sensors.json`, other films without `--parts`, and with
  `--front-end sfm`, on commit {commit}. Rendered by `python scripts/pages/sensors_page.py > docs/lab/sensors.md`.

Sensors of 64x64 and of 240x180 zones: 3 % of noise, holes at grazing angles and highlights, 5 % dropped. Stereo: 4 mm
between the eyes, 320 px each, both under the lamps of the left one. Odometry, and in rows that say
`sfm` COLMAP's mapper; lens given, one run each. ATE: RMSE of camera centres.
F-score at 1 mm, in mm: the surface moved by the path's SE(3), without any scale.
"""

COLUMNS = """
| | scale error | ATE, Sim(3) | ATE, SE(3) | rotation | F-score, Sim(3) | F-score, in mm |
|---|---|---|---|---|---|---|"""

READ = """## What the parts are

- **Adjustment** (`sensor.adjust: false` leaves it out): residuals of depth in bundle adjustment. Without it the whole
  map is scaled by the median ratio.
- **Points** (`sensor.points: none`): the sensor's points join the map's before completion.
- **Gathering** (`sensor.points: own`): a keyframe's points are what the depth of the frames up to 12 before and after
  it agrees on; without it they are of its own depth.
"""


def page(record: dict[str, Any]) -> str:
    runs = record["runs"]
    commits = sorted({run["commit"][:7] for run in runs})
    parts = [HEAD.format(commit=", ".join(commits))]
    for film in dict.fromkeys(run["sequence"] for run in runs):
        mine = [run for run in runs if run["sequence"] == film]
        posed = ", ".join(dict.fromkeys(f"{run['posed']} of {run['frames']}" for run in mine if _tracked(run)))
        parts.append(f"## {film} ({posed} frames posed by odometry)")
        parts.append("\n".join([COLUMNS, *map(_row, mine)]).rstrip() + "\n")
    return "\n".join([*parts, READ])


def _tracked(run: dict[str, Any]) -> bool:
    """Whether odometry ended well on it."""
    return "posed" in run and not run["method"].startswith("sfm")


def _row(run: dict[str, Any]) -> str:
    name = run["method"]
    if "failed" in run:
        return f"| {name} | {run['failed']} | | | | | |"
    scale = "-" if run["scale_error"] is None else f"{100 * run['scale_error']:.2f} %"
    ate = "-" if run["ate_se3_mm"] is None else f"{run['ate_se3_mm']:.3f} mm"
    surface = "-" if run["f_se3"] is None else f"{run['f_se3']:.1f} %"
    return (
        f"| {name} | {scale} | {run['ate_sim3_mm']:.3f} mm | {ate} | {run['rotation_deg']:.2f} deg | "
        f"{run['f_sim3']:.1f} % | {surface} |"
    )


if __name__ == "__main__":
    print(page(json.loads(RECORD.read_text())), end="")
