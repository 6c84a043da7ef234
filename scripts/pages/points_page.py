"""docs/lab/points.md from benchmarks/results/points.json.

python scripts/pages/points_page.py > docs/lab/points.md
"""

import json
import statistics
from itertools import pairwise
from pathlib import Path
from typing import Any

RECORD = Path(__file__).parents[2] / "benchmarks/results/points.json"
OWN, ANEW, REFINED = "the front end's own", "triangulated anew", "refined"
KINDS = (OWN, ANEW, REFINED)
# Films on which the method and its constants were chosen, and one on which its gain was first seen.
BURNT = ("choose_colon_pinhole", "choose_csd_fisheye", "choose_small_intestine_pinhole")
CHOSEN_ON = ("withdrawal_b", "low_texture_b", "insertion_b", "easy_withdrawal", *BURNT)
# While they were chosen or soon after, but not chosen on.
LOOKED_AT = ("ctcolon", "choose_colon_fisheye", "flexure_b")

HEAD = """# Points that the poses triangulate anew, and that the pictures refine

- **Question:** A bundle adjustment of some thousand features forgives wrong matches and rays that hardly meet at an
  angle: its poses lose nothing by them. What does depth lose, which is completed from those points? And what by
  features that are found to half a pixel, and corners that slide while they are followed?
- **Answer:** On {count} films that nothing was chosen on, points triangulated anew changed the F-score by {anew}.
  Refined by their patches as well, by another {refined}.
- **Command:** `python -m benchmarks.points FILMS --json {record}` at
  {commit} on one machine ({machine}); rendered by `python scripts/pages/points_page.py > docs/lab/points.md`.
- **Films:** rendered ones with truth, lens given, one seed. Reported: nothing was chosen there. Chosen on: the
  constants were chosen there, or the gain was first seen there. Looked at: figures known while they were chosen.

Number of points of the largest submap from which depth is completed, and |log(depth / true depth)| of each: median /
mean, and the share off by more than a tenth. F-score at 1 mm (precision, recall) of the mesh: from the front end's own
points, from those triangulated anew, and from these refined, with the same poses. The last columns are the change of
the F-score by triangulating anew, and by refining. Keyframes are chosen by the points.

"""
PART = "points | off, % | over a tenth, % | F-score, % |"
TABLE = (
    f"| film | | {' '.join(f'{kind}: {PART}' for kind in ('own', 'anew', 'refined'))} anew | refined |\n{'|---' * 16}|"
)

FOOT = """
## How it is done

- **Matched anew.** Features of frames 1.2 % of the width apart at the median depth (more of them than odometry has
  keyframes; closer in a film that would have fewer than 32, see [hovering.md](hovering.md)) are matched where the
  poses and the points expect them, as in the last adjustment of odometry; but by points that were cleaned first, and
  without a division of features by their size. COLMAP's own points serve as a start, too.
- **Triangulated from the poses alone.** An adjustment that starts where interpolated depth put a feature leaves some of
  them there. An observation that is off by more than twice the median error, and by half as much as the worst of its
  track, is dropped, up to four times; what then does not meet, or at less than 0.6 degrees, is no point. Less than 0.4
  px is always forgiven.
- **The poses stay here,** and tracked corners are not triangulated anew. (In a run, both are adjusted to these features
  first, see [pose_adjustment.md](pose_adjustment.md); this benchmark leaves that out.) The front end's own points judge
  the map: the probability that it is wrong and the wall's motion are calibrated on their residuals, and a point that
  moved with the wall is an outlier here and evidence there.
- **Refined by patches** (`pipeline/frontend/point_refinement.py`, `pipeline/matching/patch_alignment.py`). 9x9 pixels
  about a point in the middle one of the frames that see it are compared with up to eight others; the depth along the
  ray is that at which they fit best. The wall about the point is taken for a plane, whose slope is that of the points
  around. A point that more than half of the frames confirm gets the new depth and an expected error from how well it is
  held, whose constants were fitted by maximum likelihood on four films (`withdrawal_b`, `choose_csd_fisheye`,
  `choose_colon_pinhole`, `choose_small_intestine_pinhole`). Whether that error is calibrated on other films was not
  measured. Poses are held fixed. Points that a sensor's depth has adjusted are left alone.
- **Unsure points at strong contrast are dropped**: those whose standard deviation times contrast is over three times
  the submap's median. Many of them lie on outlines of folds, along which a patch may slide. So the columns of errors
  gain by what is dropped, too.

## Tried, and not taken

By the same films' F-scores while the method was chosen; the trials' scripts were not kept.

- To drop a whole track for one observation above 1.2 px: best on pictures without noise, but on `low_texture_b`, whose
  features are found half a pixel off, half of all points were lost, and the F-score with them.
- A fixed limit of 0.8, 1.2 or 2 px for an observation: each was best on another film. The limit follows the film.
- 1.5, 2.5, 3 and 4 times the median error; to ask that half or three quarters of a track's observations stay.
- Odometry's own keyframes instead of denser frames: the gain on `withdrawal_b` and `low_texture_b` is gone.
- No tracked corners: no better, and three times as many keyframes are completed.
- Keyframes 2 % of the width apart: a third less time for this stage, and 0.4 to 1.8 points less on the three films.
- Features of pictures in which dark wall is made brighter, where there are few: by a square root, by CLAHE, by the
  mean brightness around. F-score -3.3 to +1.5, -1.3 to -0.6 and -4.1 to +1.1 on six films kept for choosing.

Of refined points, by the films named there as chosen on; scripts not kept:

- Two rounds, the second with the slopes of the refined points; patches of 7x7 and 13x13 pixels; four steps; steps of
  half a pixel; six views: the points are as good, or a little worse.
- More points, of corners away from those that there are, at a depth between their neighbours: 400 to 5,000 more a
  film, of which up to 22 % are off by more than a tenth. F-score -0.8 to +0.0 on `withdrawal_b`, `low_texture_b` and
  `choose_csd_fisheye`.
- Followed corners that are refined kept beside features as good: F-score -1.1 to +0.2 on six films.
- Points that the pictures do not confirm left out altogether: F-score -0.2 to +0.7 on four films.
- To drop by the deviation in pixels times contrast, in place of that of depth: on `choose_csd_fisheye` twice as many
  points that are off by more than a tenth stay.

What better points would be worth, and how to get them, on three films kept for choosing (`low_texture_b`,
`choose_colon_fisheye`, `choose_small_intestine_pinhole`; one run each, scripts not kept):

- **True depth at the points that there are**: F-score +9.9, +1.5 and -0.3. On `low_texture_b` wrong points limit the
  surface: with the same points, but the true error of each given to completion, the F-score rises by 6.3. On the other
  two completion between the points limits it: true depth every 8 px beside the points raises it by 3.3 and 10.7 (by
  13.4 on `low_texture_b`).
- Twelve frames in which a point must show, whether or not it was matched there, and 11x11 px: on six films (these,
  `withdrawal_b`, `choose_csd_fisheye` and `choose_colon_pinhole`) the median error of confirmed points falls by 0 to
  30 %; on four of them, all but `withdrawal_b` and `choose_colon_pinhole`, the F-score changes by -0.4 to +0.3.
- The same, begun at completed depth and with its slopes, and depth completed again: of the points of `low_texture_b`
  8 % are off by more than a twentieth, not 27 %. F-score +0.9 to +1.5, -0.0 and 0.0 to +0.4, for a second completion.
- Points left out that completed depth passes by more than 4 %, and depth completed again: +2.5 and -0.1 on the first
  two.
- Points on a grid of 8 px, begun at completed depth: where patches confirm them, they are farther off in the median
  than completed depth is there (1.26 to 0.89, 0.65 to 0.61, 1.04 to 0.79 %). What they say together about depth that is
  complete is worth more: [photometric.md](photometric.md).
"""


def _points(run: dict[str, Any]) -> str:
    off = f"{run['off_median_percent']:.1f} / {run['off_mean_percent']:.1f}"
    score = f"{run['f_score']:.1f} ({run['precision']:.1f}, {run['recall']:.1f})"
    return f"{run['points']} | {off} | {run['far_off_percent']:.1f} | {score}"


def _in_words(gains: list[float]) -> str:
    rose, mean, median = sum(gain > 0 for gain in gains), statistics.mean(gains), statistics.median(gains)
    spread = f"({min(gains):+.1f} to {max(gains):+.1f})"
    return f"{median:+.1f}\n  points in the median and {mean:+.1f} in the mean {spread}; it rose on {rose}"


def kind(name: str) -> str:
    """Of a film, whatever the front end."""
    film = name.split(",")[0]
    return "chosen on" if film in CHOSEN_ON else "looked at" if film in LOOKED_AT else "reported"


def page(record: dict[str, Any]) -> str:
    """The page, as committed."""
    films: dict[str, dict[str, dict[str, Any]]] = {}
    for run in record["runs"]:
        films.setdefault(run["sequence"], {})[run["method"]] = run
    order = ("reported", "looked at", "chosen on")
    rows, gains = [], []
    for name, by in sorted(films.items(), key=lambda item: order.index(kind(item[0]))):
        score = [by[points]["f_score"] for points in KINDS]
        gain = [after - before for before, after in pairwise(score)]
        parts = " | ".join(_points(by[points]) for points in KINDS)
        rows.append(f"| {name} | {kind(name)} | {parts} | {gain[0]:+.1f} | {gain[1]:+.1f} |")
        if kind(name) == "reported":
            gains.append(gain)
    commits = sorted({run["commit"][:7] for run in record["runs"]})
    about = record["environment"]
    head = HEAD.format(
        count=len(gains),
        anew=_in_words([first for first, _ in gains]),
        refined=_in_words([second for _, second in gains]),
        record=f"benchmarks/results/{RECORD.name}",
        commit=", ".join(commits),
        machine=f"{about['processor']}, {about['cores']} cores, Python {about['python']}",
    )
    return "\n".join([head + TABLE, *rows, FOOT])


if __name__ == "__main__":
    print(page(json.loads(RECORD.read_text())), end="")
