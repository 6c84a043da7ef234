"""docs/lab/long_videos.md from benchmarks/results/long_video.json: long films through the whole of `reconstruct`.

python scripts/pages/long_page.py > docs/lab/long_videos.md
"""

import json
from pathlib import Path
from typing import Any

LONGEST = 10_000  # frames of the longer film
DRIFTS = "scale_off_percent", "end_error_percent"
RECORD = Path(__file__).parents[2] / "benchmarks/results/long_video.json"

HEAD = """# Long videos

- **Question:** How do time, memory and the error of the path grow with the number of frames?
- **Command:** `python -m benchmarks.long_video WITHDRAWAL --json J`, then with `LONG --frames 1000 10000`,
  on commit {commit}.
  {processor}, {cores} cores, Python {python}; one run each, with no other job beside it. Rendered from
  `benchmarks/results/long_video.json` by `python scripts/pages/long_page.py > docs/lab/long_videos.md`.
- **Films:** rendered, 320x320 px, lossless, lens given: a withdrawal over 450 mm (`benchmarks/withdrawal.yaml`), and
  one through 1.5 m of colon (`benchmarks/long_video.yaml`), from its beginning. The damping of the bundle
  adjustment was chosen with both in view ([front_end.md](front_end.md)), nothing else.
- **Protocol:** `reconstruct --profile`, default settings, seed 0. Seconds are of the whole process, the peak is its
  resident memory, without that of a COLMAP that is asked for a second opinion. Path: RMSE of camera centres after one
  Sim(3) a submap.

| film | frames | used | posed | submaps | keyframes | path (mm) | seconds | frames/s | peak (MiB) | path error (mm) |
|---|---|---|---|---|---|---|---|---|---|---|
"""

DRIFT = """
Stretches of {stretch:.0f} mm of true path, one beginning every half stretch. Scale: how far the scale of a stretch's
own Sim(3) is from the median one of its submap, of submaps with three stretches and more. End error: distance at the
end of a stretch whose first quarter is fitted, over its length.

| film | frames | stretches | scale about its median: median, most (%) | end error: median, most (%) |
|---|---|---|---|---|
"""

BEND = """
**What bounds the scale of the longest film.** Within 100 mm a path's end is off by {end:.1f} % of the way (median),
but the scale is off the film's own median by {off:.1f} % (median; {most:.1f} % at most): it bends slowly. Neighbouring
stretches share wall, distant ones nothing, so that what each leaves adds up. The path is {ate:.1f} mm off (RMSE) all
the same. A second visit, which loop closing finds, or a known size (a sensor, the lumen's diameter) would tie distant
stretches; this film has neither.

**What takes the memory.** The map itself: tracked corners and features, and where every frame saw them; then the voxels
of the wall along {length:.1f} m of path. Pictures, and features of all but 256 frames, wait in files.
"""

STAGES = """
Seconds of each stage, and the peak of memory by its end (MiB):

| film | frames | {names} |
|---|---|{rule}|
"""


def label_of(row: dict[str, Any]) -> str:
    return str(row["sequence"].split(",")[0].replace("_", " "))


def run_line(row: dict[str, Any]) -> str:
    error = f"{row['ate_mm']:.2f}" if "ate_mm" in row else "-"
    return (
        f"| {label_of(row)} | {row['frames']:,} | {row['used']:,} | {row['posed']:,} | {row['submaps']} | "
        f"{row['keyframes']} | {row['path_mm']:.0f} | {row['seconds']:.0f} | {row['frames_per_s']:.1f} | "
        f"{row['peak_mib']:,.0f} | {error} |"
    )


def drift_line(row: dict[str, Any]) -> str:
    figures = (row[name] and f"{row[name][0]:.1f}, {row[name][1]:.1f}" for name in DRIFTS)
    cells = " | ".join(figure or "-" for figure in figures)
    return f"| {label_of(row)} | {row['frames']:,} | {row['stretches']} | {cells} |"


def page(record: dict[str, Any]) -> str:
    """All of it."""
    runs, environment = record["runs"], record["environment"]
    of = {row["commit"][:7]: [f"{r['frames']:,}" for r in runs if r["commit"] == row["commit"]] for row in runs}
    commits = ", ".join(f"{commit} ({'; '.join(frames)} frames)" for commit, frames in of.items())
    about = {name: environment[name] for name in ("processor", "cores", "python")}
    names = list(runs[0]["stages"])
    lines = [HEAD.format(commit=commits, **about) + "\n".join(map(run_line, runs))]
    lines.append(DRIFT.format(stretch=runs[0]["stretch_mm"]) + "\n".join(map(drift_line, runs)))
    longest = max(runs, key=lambda row: int(row["frames"]))
    if longest["frames"] >= LONGEST:
        (off, most), (end, _) = longest["scale_off_percent"], longest["end_error_percent"]
        length = longest["path_mm"] / 1000
        lines.append(BEND.format(end=end, off=off, most=most, ate=longest["ate_mm"], length=length).rstrip())
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
