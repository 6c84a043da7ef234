"""docs/lab/live.md from benchmarks/results/live*.json: whether live sessions keep up, how soon, in how much memory.

python -m scripts.pages.live_page > docs/lab/live.md
"""

import json
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks/results"
RECORDS = {"nothing drawn": "live.json", "drawn by Chromium": "live_drawn.json", "played again": "live_looped.json"}

HEAD = """# Live sessions

- **Date:** 2026-11-25
- **Question:** Does `haustra live` keep up with films of 30 frames a second, how soon is a keyframe's surface there,
  and does memory grow?
- **Command:** `python -m benchmarks.speed live FILMS --runs 3 --json live.json`, on commit {commit}; {processor},
  {cores} cores, Python {python}; the same with `--browser chromium` (`live_drawn.json`, commit {drawn}) and with
  `--seconds` (`live_looped.json`, commit {looped}). Rendered from `benchmarks/results/live*.json` by
  `python -m scripts.pages.live_page > docs/lab/live.md`.
- **Protocol:** the command in a process of its own, default settings, without the run at the end. *Kept up with*:
  frames that were judged and, where they are worth it, tracked, over the time from the first to the last of them.
  *Surface after*: from a keyframe's frame to its surface in the state that the page asks for; drawing comes on top.
  Median of the runs, in brackets the least and the greatest; the median and the worst are of each run's keyframes.
- **Films:** looked at while the session was made: development figures.

"""
COLUMNS = (
    *("session", "film", "frames/s kept up with", "frames posed, of those that came", "keyframes fused, skipped"),
    *("reviews", "surface after, median, s", "worst, s", "peak MiB"),
)

READ = """
{growth}

## How

- Three processes: tracking with reading; completion, fusion and extraction; and, at low priority, loops, earlier maps
  and coverage.
- Voxels are twice as large as in a run: an eighth of the work, and about as many triangles as a page can draw.
- Every process does its work once on a small drawn map before the film begins: compiled loops and libraries load at
  their first use, which takes seconds.
- The page draws with plotly, which the report has already, at one pixel of canvas for each of the page, and the less
  often the longer drawing takes: a browser without a graphics card draws on the processors that the tracker needs.

## What was not tried

A camera, RTSP, a graphics card, Windows, macOS; another viewer than plotly.
"""


def rows_of(label: str, record: dict[str, Any]) -> list[str]:
    """A line a film."""
    lines = []
    for film, figures in record["films"].items():
        runs = [run for run in record["runs"] if run["film"] == film]
        posed = sum(run["counts"]["posed"] for run in runs) / sum(run["counts"]["came"] for run in runs)
        shown, skipped = (sum(run["counts"][name] for run in runs) / len(runs) for name in ("shown", "dropped"))
        cells = [label, film, _spread(figures["kept_up_per_s"], ".1f"), f"{100 * posed:.0f} %"]
        cells += [
            f"{shown:.0f}, {skipped:.0f}",
            f"{sum(run['counts']['reviews'] for run in runs) / len(runs):.0f}",
            _spread(figures["median_s"], ".2f"),
            _spread(figures["worst_s"], ".2f"),
        ]
        lines.append("| " + " | ".join([*cells, f"{figures['peak_mib']['max']:.0f}"]) + " |")
    return lines


def _spread(figure: dict[str, Any], form: str) -> str:
    if len(figure["values"]) == 1:
        return f"{figure['median']:{form}}"
    return f"{figure['median']:{form}} [{figure['min']:{form}}, {figure['max']:{form}}]"


def growth_of(record: dict[str, Any]) -> str:
    """What a long session needed."""
    run = record["runs"][0]
    counts, growth = run["counts"], run["growth_mib_per_minute"]
    return (
        f"Played again for {run['played_s'] / 60:.0f} minutes ({counts['came']} frames, {counts['maps']} maps of "
        f"{run['film']}), the resident memory of the second half changes by {growth:+.1f} MiB a minute, around a peak "
        f"of {run['peak_mib']:.0f} MiB (libraries that processes share are counted in each)."
    )


def page() -> str:
    """The whole note."""
    records = {label: json.loads((RESULTS / name).read_text()) for label, name in RECORDS.items()}
    here, drawn, looped = (record["environment"] for record in records.values())
    lines = [line for label, record in records.items() for line in rows_of(label, record)]
    head = HEAD.format(**here | {"drawn": drawn["commit"], "looped": looped["commit"]})
    columns = ["| " + " | ".join(COLUMNS) + " |", "|" + " --- |" * len(COLUMNS)]
    return head + "\n".join([*columns, *lines]) + "\n" + READ.format(growth=growth_of(records["played again"]))


if __name__ == "__main__":
    print(page(), end="")
