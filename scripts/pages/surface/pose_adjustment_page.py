"""docs/lab/pose_adjustment.md from the record pose_adjustment.json; the words are in pose_adjustment_page.txt.

python -m scripts.pages.surface.pose_adjustment_page > docs/lab/pose_adjustment.md
"""

import json
import statistics
from pathlib import Path
from string import Template
from typing import Any

from benchmarks.common.record import ROOT
from scripts.pages.completion_page import table
from scripts.pages.surface.hovering_page import VERSIONS, about, middle_of, rows_of, surface_of

RECORD, WORDS = ROOT / "benchmarks/results/pose_adjustment.json", Path(__file__).with_name("pose_adjustment_page.txt")
ENOUGH = 5  # films for a standard error
MOVED = {"0.0": "still", "2.5": "2.5 mm"}  # of the living suite, by the end of the film's name


def wall(film: str) -> str:
    """How far a film's wall moves."""
    return MOVED.get(film.partition("_")[2], "still")


def films(record: dict[str, Any], timed: bool = True) -> str:
    """A row for each film, both versions beside each other; `timed`: with the seconds of each."""
    before, now = (rows_of(record, version) for version in VERSIONS)
    rows = []
    for film in sorted(now, key=lambda name: (wall(name) != "still", name)):
        both = [of[film] for of in (before, now)]
        ates = [f"{one['ate_mean_mm']:.3f}" for one in both]
        surfaces = [surface_of(one) for one in both]
        seconds = [f"{one['seconds']:.0f}" for one in both] if timed else []
        posed = f"{both[1]['posed']} of {both[1]['informative']}"
        rows.append([film, wall(film), posed, *ates, *surfaces, f"{_gain(both):+.1f}", *seconds])
    head = ["film", "wall", "posed", "ATE (mm) before", "now", "F-score (precision, recall), % before", "now", "change"]
    return table([*head, "seconds before", "now"] if timed else head, rows)


def _gain(both: list[dict[str, Any]]) -> float:
    return float(both[1]["f_score_percent"] - both[0]["f_score_percent"])


def change(record: dict[str, Any], still: bool) -> str:
    """Change of F-score and ATE over the films whose wall stands still, or moves; of those whose maps are of one front
    end, since another map is another path. The standard error takes films for independent, and is not told of few."""
    before, now = (rows_of(record, version) for version in VERSIONS)
    of_role = [film for film in now if (wall(film) == "still") == still]
    names = [film for film in of_role if before[film]["front_end"] == now[film]["front_end"]]
    left = [f"`{film}`" for film in of_role if film not in names]
    gains = [_gain([before[film], now[film]]) for film in names]
    means = " to ".join(
        f"{statistics.fmean(of[film]['f_score_percent'] for film in names):.1f}" for of in (before, now)
    )
    ates = " to ".join(f"{statistics.median(of[film]['ate_mean_mm'] for film in names):.3f}" for of in (before, now))
    spread = f"{min(gains):+.1f} to {max(gains):+.1f}"
    if len(gains) >= ENOUGH:
        others = statistics.fmean(sorted(gains)[:-1])
        error = statistics.stdev(gains) / len(gains) ** 0.5
        spread = f"standard error {error:.1f}; {spread}; without the greatest {others:+.1f} in the mean"
    return (
        f"mean F {means} %; change {middle_of(gains)} ({spread}, falling in "
        f"{sum(gain < 0 for gain in gains)} of {len(names)} films); ATE {ates} mm in the median"
        + (f"; without {', '.join(left)}, whose map is of another front end" if left else "")
    )


def page(record: dict[str, Any], words: Path = WORDS, timed: bool = True) -> str:
    """Of a record of two versions on the same films; also for other changes (`kriging_page.py`). timed: their seconds
    compare."""
    before, now = (rows_of(record, version) for version in VERSIONS)
    longer = [now[film]["seconds"] - before[film]["seconds"] for film in now]
    return Template(words.read_text()).substitute(
        about(record),
        films=films(record, timed),
        still=change(record, still=True),
        moving=change(record, still=False),
        seconds=f"{statistics.median(longer):+.1f} s in the median ({min(longer):+.1f} to {max(longer):+.1f})",
    )


if __name__ == "__main__":
    print(page(json.loads(RECORD.read_text())), end="")
