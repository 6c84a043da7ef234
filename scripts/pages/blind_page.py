"""docs/lab/blind_stretch.md from benchmarks/results/blind.json: a second without pictures, with and without a sensor.

python scripts/pages/blind_page.py > docs/lab/blind_stretch.md
"""

import json
import statistics
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
RECORD = ROOT / "benchmarks/results/blind.json"

HEAD = """# A second without pictures

- **Date:** 2026-11-27
- **Question:** Where pictures show nothing for a second, does a depth sensor carry the camera over?
- **Command:** `haustra phantom SUITE --suite`; of each film `python scripts/simulated_sensor.py SUITE/FILM SENSED/FILM
  --noise 0.03 --blind FIRST LAST` (64x64 zones, 3 % of noise, 30 pictures blurred away); then
  `python -m benchmarks.reconstruction blind-stretch SENSED/* --truth SUITE --json benchmarks/results/blind.json`,
  and on five films of `benchmarks/coverage_films.yaml` the same with `--chosen` and no blind pictures. On commit
  {commit}. Rendered by `python scripts/pages/blind_page.py > docs/lab/blind_stretch.md`.

## Tracking

`--fast`, lens given; ATE RMSE of the largest submap's frames. Blind are frames 60 to 89, of `flexure` 100 to 129.

| film | | submaps | frames posed (of usable) | in the largest | ATE, Sim(3) | ATE, SE(3) |
|---|---|---|---|---|---|---|"""

GAPS = """
Where pictures alone leave two maps and the sensor one, in mm, the sensor's depth carried the camera over: {joined}.
Where both leave one, matched features join the maps anyway{apart}.

## The registration alone

30 frames are taken for blind at every 20th frame, with true poses on both sides; error of the first pose after them.

| film, last frame before | constant velocity | registered |
|---|---|---|"""

READ = """
- Reported on (the table): {reported}.
- Chosen on (`benchmarks/coverage_films.yaml`: withdrawal_b, flexure_b, flexure_c, loop_b, low_texture_b): {chosen}.

The limits of the gate below were chosen on the latter, but for the two of the way back, which were chosen on gaps of
the table.

## How it is done

- Both maps are in mm by the sensor. The clouds of the last 40 frames, one in four, are the wall; each third frame of
  the gap is registered to it **point to plane**, from a velocity that goes over from the one before the gap to the one
  after it; then the clouds of the first 40 frames after the gap together.
- **Edge of the wall:** a point that lies beside all that was seen has no match; with one it would draw the cloud over
  the edge.
- **Turn about the axis** slips first. Where three quarters of the first cloud lie where wall was seen, the clouds after
  the gap are also registered from guesses turned by up to 32 deg, and the one that fits best is tried first.
- **Directions that the wall does not hold** (eigenvalues of the Hessian below 0.03 of 1) stay with the velocity. On a
  colon with folds none is so weak; in a smooth tube the way along the axis and the turn about it are.
- **Gate:** the way back, from after the gap to before it, must end within 6 deg and 2.5 mm; the first cloud may lie
  1.6 times as far from the wall as a cloud of either side from those beside it; 30 % of it must lie where wall was
  seen, 75 % after a turned guess. The middle of both ways is taken.
- The joined map is adjusted to its features, which then hold the seam where there are enough.
- **Point to point**, as KISS-ICP has it, slides along a tube; KISS-ICP is measured alone in [kiss_icp.md](kiss_icp.md).
- Clouds of the gap are not added to the wall, since each carries the error of its own pose.
- Frames of the gap get no pose of their own: their pictures are worth nothing to depth and surface.
"""


def page(record: dict[str, Any]) -> str:
    runs = record["runs"]
    lines = [HEAD.replace("{commit}", record["environment"]["commit"][:7])]
    lines += [_tracked(run) for run in runs if "submaps" in run]
    lines.append(_joins([run for run in runs if "submaps" in run]))
    gaps = [(run["sequence"], gap) for run in runs if run["method"] == "registration" for gap in run["gaps"]]
    lines += [f"| {film}, {gap['end']} | {_off(gap['guess'])} | {_off(gap['found'])} |" for film, gap in gaps]
    chosen = [gap for run in runs if run["method"] == "registration, chosen on" for gap in run["gaps"]]
    return "\n".join([*lines, READ.format(reported=_summed([gap for _, gap in gaps]), chosen=_summed(chosen))])


def _joins(runs: list[dict[str, Any]]) -> str:
    """What the table of tracking says, in words."""
    submaps = {(run["sequence"], run["method"]): run["submaps"] for run in runs}
    films = dict.fromkeys(run["sequence"] for run in runs)
    alone = {film: (submaps[film, "pictures alone"], submaps[film, "with the sensor"]) for film in films}
    joined = ", ".join(f"`{film}`" for film, (before, after) in alone.items() if before > 1 and after == 1) or "none"
    apart = ", ".join(f"`{film}`" for film, (_, after) in alone.items() if after > 1)
    return GAPS.format(joined=joined, apart=f"; {apart} stays in parts" if apart else "")


def _summed(gaps: list[dict[str, Any]]) -> str:
    """How many gaps are accepted, with which errors."""
    mm, deg = zip(*(gap["found"] for gap in gaps if gap["found"]), strict=True)
    guess_mm, guess_deg = zip(*(gap["guess"] for gap in gaps), strict=True)
    median, mean = statistics.median, statistics.fmean
    return (
        f"{len(mm)} of {len(gaps)} gaps are accepted, median {median(mm):.2f} mm and {median(deg):.1f} deg, mean "
        f"{mean(mm):.2f} mm and\n  {mean(deg):.1f} deg, at worst {max(mm):.2f} mm and {max(deg):.1f} deg; velocity "
        f"alone is off by {median(guess_mm):.1f} mm and {median(guess_deg):.0f} deg in the median"
    )


def _tracked(run: dict[str, Any]) -> str:
    se3 = "-" if run["ate_se3_mm"] is None else f"{run['ate_se3_mm']:.3f} mm"
    return (
        f"| {run['sequence']} | {run['method']} | {run['submaps']} | {run['posed']} ({run['usable']}) | "
        f"{run['largest']} | {run['ate_sim3_mm']:.3f} mm | {se3} |"
    )


def _off(error: list[float] | None) -> str:
    return "refused" if error is None else f"{error[0]:.2f} mm, {error[1]:.1f} deg"


if __name__ == "__main__":
    print(page(json.loads(RECORD.read_text())), end="")
