"""docs/lab/long_videos.md from benchmarks/results/long_video.json: long films through the whole of `reconstruct`.

python scripts/pages/long_page.py > docs/lab/long_videos.md
"""

import json
from pathlib import Path
from typing import Any

LONGEST = 10_000  # frames of the longer film
RECORD = Path(__file__).parents[2] / "benchmarks/results/long_video.json"

HEAD = """# Long videos

- **Question:** How do time, memory and the error of the path grow with the number of frames?
- **Command:** `python -m benchmarks.long_video WITHDRAWAL --json J`, then with `LONG --frames 1000 10000`,
  on commit {commit}. {processor}, {cores} cores, Python {python}; one run each, with other work beside
  it, so that the seconds say little. Rendered from
  `benchmarks/results/long_video.json` by `python scripts/pages/long_page.py > docs/lab/long_videos.md`.
- **Films:** rendered, 320x320 px, lossless, lens given: a withdrawal over 450 mm (`benchmarks/withdrawal.yaml`), and
  one through 1.5 m of colon (`benchmarks/long_video.yaml`), from its beginning. The damping of the bundle
  adjustment was chosen with both in view ([front_end.md](front_end.md)), nothing else.
- **Protocol:** `reconstruct --profile`, default settings, seed 0. Seconds are of the whole process, the peak is its
  resident memory. Path: RMSE of camera centres after one Sim(3) a submap.

| film | frames | used | posed | submaps | keyframes | path (mm) | seconds | frames/s | peak (MiB) | path error (mm) |
|---|---|---|---|---|---|---|---|---|---|---|
"""

DRIFT = """
Drift over stretches of {stretch:.0f} mm of true path, one beginning every half stretch. Scale: of a Sim(3) fitted to
each, about the median one. End error: distance at the end of a stretch whose first quarter is fitted, over its length.

| film | frames | stretches | scale off: median, most (%) | end error: median, most (%) |
|---|---|---|---|---|
"""

STAGES = """
Seconds of each stage, and the peak of memory by its end (MiB):

| film | frames | {names} |
|---|---|{rule}|
"""


def label_of(row: dict[str, Any]) -> str:
    return str(row["sequence"].split(",")[0].replace("_", " "))


def run_line(row: dict[str, Any]) -> str:
    return (
        f"| {label_of(row)} | {row['frames']:,} | {row['used']:,} | {row['posed']:,} | {row['submaps']} | "
        f"{row['keyframes']} | {row['path_mm']:.0f} | {row['seconds']:.0f} | {row['frames_per_s']:.1f} | "
        f"{row['peak_mib']:,.0f} | {row['ate_mm']:.2f} |"
    )


def drift_line(row: dict[str, Any]) -> str:
    if not row["stretches"]:
        return f"| {label_of(row)} | {row['frames']:,} | 0 | - | - |"
    return (
        f"| {label_of(row)} | {row['frames']:,} | {row['stretches']} | {row['scale_off_median_percent']:.1f}, "
        f"{row['scale_off_most_percent']:.1f} | {row['end_error_median_percent']:.1f}, "
        f"{row['end_error_most_percent']:.1f} |"
    )


def page(record: dict[str, Any]) -> str:
    """All of it."""
    runs, environment = record["runs"], record["environment"]
    commits = ", ".join(sorted({row["commit"][:7] for row in runs}))
    about = {name: environment[name] for name in ("processor", "cores", "python")}
    names = list(runs[0]["stages"])
    lines = [HEAD.format(commit=commits, **about) + "\n".join(map(run_line, runs))]
    lines.append(DRIFT.format(stretch=runs[0]["stretch_mm"]) + "\n".join(map(drift_line, runs)))
    stages = STAGES.format(names=" | ".join(names), rule="|".join("---" for _ in names))
    for row in runs:
        cells = (f"{seconds:.0f} s, {peak:.0f}" for seconds, peak in row["stages"].values())
        stages += f"| {label_of(row)} | {row['frames']:,} | {' | '.join(cells)} |\n"
    lines.append(stages.rstrip())
    if all(row["frames"] < LONGEST for row in runs):
        lines.append(f"\n{LONGEST:,} frames, which the command asks for too, are not measured.")
    return "\n".join(lines)


if __name__ == "__main__":
    print(page(json.loads(RECORD.read_text())))
