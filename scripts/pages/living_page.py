"""docs/lab/living.md from benchmarks/results/living*.json: path and surface of films whose wall moves, and ceilings.

python scripts/pages/living_page.py > docs/lab/living.md
"""

import json
import statistics
from functools import partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
RECORDS = ROOT / "benchmarks/results"
NAMES = ("living.json", "living_ceilings.json", "living_motion.json")
POINTS_AT_TRUE_DEPTH = "true poses, depth from points at true depth"
POINTS_OF_TRUE_POSES = "true poses, depth from points of true poses"
FUSED = (
    "true poses, true depth",
    "run's poses, true depth",
    POINTS_AT_TRUE_DEPTH,
    POINTS_OF_TRUE_POSES,
    "true poses, run's depth",
    "run's poses, run's depth",
)
BY = {"odometry": "odometry", "sfm": "COLMAP"}
AMPLITUDES = {"0.0": "0", "2.5": "2.5", "5.0": "5", "10": "10"}

HEAD = """# Walls that move

- **Date:** 2026-12-01
- **Question:** How far off are the camera path and the surface when the wall moves by 0, 2.5, 5 or 10 mm?
- **Films:** the sweep of `haustra/phantom/dataset/living.yaml`: three recorded paths of a real hand (C3VD, 18 to 46 mm
  long), each filmed with four walls, through the lens and lamp of endoscopes 3, 9 and 13; 600 frames of 400x300,
  H.264, lens given. No threshold was fitted to them. But that COLMAP maps every n-th frame was first tried on path b at
  5 mm, and that its map may win where the light contradicts both was mended after a look at path b at 10 mm. Two more
  rules were decided on a real clip: that a correlation which chance has contradicts nothing (lighting check), and that
  a map is not given up for one that is expected to pose fewer frames rightly.
- **Command:** `python -m benchmarks.living FILMS/* --json living.json`, and the same with `--checkout` of the version
  `before` and `--name before`, on the same films; {processor}, {cores} cores, nothing beside it. Seed 0, one run a
  film. Rendered from `benchmarks/results/living.json` by `python scripts/pages/living_page.py > docs/lab/living.md`.

ATE is CLiMB's: mean distance of camera centres after one Sim(3) a submap, weighted by matched poses. F-score at 1 mm is
that of the largest submap's mesh against the wall at rest, after the Sim(3) of its camera poses; it counts against the
mesh all wall that any frame saw from nearer than 60 mm, posed or not.
"""

READ = """
## How to read it

- **The camera's own path is short**: 18 to 46 mm in 20 s, while the wall moves by up to 10 mm at up to 10 mm/s. A wall
  that moves as a whole cannot be told from a camera that moves: a fifth of the amplitude is such a shift.
- **A low ATE is no proof of a right map.** The Sim(3) of so short and straight a path is turned easily: rotations
  after alignment are off by degrees, and the surface, which lies 20 to 60 mm away, by millimetres.
- **COLMAP's maps** are of every n-th frame (`now`), and the frames between are posed by their points: COLMAP is asked
  where odometry's map may well be wrong ([front end](../guide/front_end.md)). `before` asked it only about stretches of
  which it could map every frame. Its maps of moving walls are mostly better, of path b at 2.5 and 5 mm not; why is not
  known.
- **No model of motion.** Poses and points are adjusted as if the wall stood still, and depth is averaged over time.
  That it moved is said (below); why no more is done follows.
"""

CEILINGS = """
## What would be possible

F-score at 1 mm, as above, of the three paths and in the mean: our own fusion fed with the film's true poses and depth,
or with those of a run, and with each frame's depth carried to the wall at rest by the true motion, which is what a
perfect model of motion would do. True poses and depth: every sixth frame of the film; the others: keyframes of the
largest submaps of `now`'s runs. Depth *from points* is completed once more: from the run's points, each at the true
depth of its pixel in that frame, or from features that are triangulated and refined as in a run, but by true poses.
`python -m benchmarks.living_ceilings FILMS/* --runs RUNS --json living_ceilings.json`; commit {commit}.

| amplitude (mm) | fused | frames fused | motion left in: paths | mean | carried to rest: paths | mean |
|---|---|---|---|---|---|---|
{rows}

- **Points.** On true poses, the run's depth gives {run_2_5:.1f}, {run_5:.1f} and {run_10:.1f} % at 2.5, 5 and 10 mm;
  depth from the same points, each where the wall is in that frame, {points_2_5:.1f}, {points_5:.1f} and
  {points_10:.1f} %, and carried to rest, too, {carried_points_2_5:.1f}, {carried_points_5:.1f} and
  {carried_points_10:.1f} %. That takes the motion of each point. Depth from features that the same true poses
  triangulate as if the wall stood still gives {static_2_5:.1f}, {static_5:.1f} and {static_10:.1f} %.
- **Frames fused** differ from row to row: a keyframe whose depth its neighbours contradict is left out.
- **Amplitude 0: completed depth.** True depth on the run's poses gives nearly what it gives on true poses (of other
  frames); the run's depth on true poses gives no more than on its own.
- **2.5 mm: depth again.** Averaging in the fusion hardly minds the motion, and poses that follow the wall are good
  enough: their depth is not. Its points are triangulated while the wall moves as fast as the camera (1 to 2 mm/s), and
  completion follows them; in a keyframe depth is off by 3 % beside 2 % on a still wall, and its unit by 4 and 16 %
  (two choosing films), since the Sim(3) of a path of some millimetres is off where each centre is off by half a
  millimetre.
- **5 and 10 mm: depth, then motion.** With true poses and true depth a perfect model of the motion is worth
  {motion_5:.0f} points at 5 mm, and {motion_10:.0f} at 10. The run's poses then cost {poses_5:.0f} and
  {poses_10:.0f} points, its depth {depth_5:.0f} and {depth_10:.0f} more. Carrying that depth to rest by the true motion
  gains {carried_5:.1f} and {carried_10:.1f} points: a model of motion before the fusion has nothing to win, as long as
  the motion spoils the depth itself.
"""

TOLD = """
## What becomes of the motion

Of the points of each run's largest submap, median and 90 %: how far their wall is from its mean over each point's
sightings, and by how much the map misses the sightings, across the view. `explained`: share of the residuals of one
half of the points that the motion fitted to the other half foretells (`pipeline/surface/wall_motion.py`; over 2 % is
told). `python -m benchmarks.living_motion FILMS/* --runs RUNS --json living_motion.json`; commit {commit}.

| path | amplitude (mm) | the wall moved (mm) | the map misses (mm) | explained (%) | told |
|---|---|---|---|---|---|
{rows}

- **A still map takes up most of the motion**: poses and points bend to it. What is left is little more than noise. So
  there is nothing left from which the amplitude could be known afterwards.
- **That points miss a still wall together is known**, and said in {told} of the {moving} moving films above, and in
  {still_told} of the {still} still ones. The limit was chosen on six films of two other paths
  (`benchmarks/living_choosing.yaml`: still ones -9 and -5 %, moving ones 8, 13, 16, 7 %) and on fifteen rigid films of
  other suites (-8 to -1 %), by runs that no record keeps. Where the camera is fast or the map wrong, nothing may be
  left to tell it by: silence is no proof that the wall stood still.
- **It is not always the wall.** Whatever neighbours share foretells too. In a simulated rigid tube a rolling shutter of
  half a frame, a first radial term off by 0.03 and a focal length off by a tenth were told, with 13 to 33 % (by a
  script that was not kept). So the sentence names lens, shutter and path beside the wall, and submaps that closed loops
  moved are not asked. A real clip of two seconds with a guessed lens has 3 %, and what moved there is not known.
- **How far is not said.** Neither is it written to the mesh: what the residuals prove of the amplitude was a sixth of
  the true one (0.06 of 0.35 mm, choosing film).
"""

TRIED = Path(__file__).with_name("living_tried.txt").read_text()


def row_of(row: dict[str, Any]) -> str:
    """One line of the table."""
    film = f"{row['sequence'][0]} | {AMPLITUDES[row['sequence'].split('_')[1]]}"
    version = row["method"].split(",")[0]
    if row["failed"]:
        return f"| {film} | {version} | {row['failed']} | | | | | | |"
    posed = f"{row['posed']} of {row['informative']}"
    return (
        f"| {film} | {version} | {posed} | {row['submaps']} | {row['ate_mean_mm']:.2f} | "
        f"{row['rotation_40_deg']:.2f} | {row['f_score_percent']:.1f} | {BY[row['front_end']]} | {row['seconds']:.0f} |"
    )


def summary(rows: list[dict[str, Any]], version: str) -> list[str]:
    """Mean, median and worst of each amplitude."""
    lines = []
    for ending, amplitude in AMPLITUDES.items():
        mine = [r for r in rows if r["sequence"].split("_")[1] == ending and r["method"].split(",")[0] == version]
        done = [r for r in mine if not r["failed"]]
        if not done:
            continue
        ate, score = ([r[name] for r in done] for name in ("ate_mean_mm", "f_score_percent"))
        posed = [r["posed_percent"] for r in done]
        lines.append(
            f"| {amplitude} | {version} | {len(done)} of {len(mine)} | {statistics.fmean(ate):.2f}, "
            f"{statistics.median(ate):.2f}, {max(ate):.2f} | {statistics.fmean(posed):.0f}, {min(posed):.0f} | "
            f"{statistics.fmean(score):.1f}, {statistics.median(score):.1f}, {min(score):.1f} |"
        )
    return lines


def _order(row: dict[str, Any]) -> tuple[str, float, str]:
    """By path, amplitude and version."""
    path, amplitude = row["sequence"].split("_")
    return path, float(amplitude), row["method"]


def ceilings(record: dict[str, Any]) -> list[str]:
    """F-scores of what is fused, by amplitude: the three paths, and what carrying depth to rest changes."""
    lines = []
    for ending, amplitude in AMPLITUDES.items():
        for fused in FUSED:
            cells, frames = [], ""
            for motion in ("left in", "carried to rest"):
                wanted = f"{fused}, motion {motion}"
                found = {r["sequence"]: r for r in record["runs"] if r["method"] == wanted}
                rows = [found[f"{path}_{ending}"] for path in "abc" if f"{path}_{ending}" in found]
                scores, frames = [r["f_score_percent"] for r in rows], ", ".join(str(r["frames"]) for r in rows)
                shown = ", ".join(f"{score:.0f}" for score in scores)
                cells.append(f"{shown} | {statistics.fmean(scores):.1f}" if scores else "| ")
            lines.append(f"| {amplitude} | {fused} | {frames} | {' | '.join(cells)} |")
    return lines


def _mean(record: dict[str, Any], ending: str, fused: str, motion: str) -> float:
    """Mean F-score of what is fused, over the films of an amplitude."""
    rows = [r for r in record["runs"] if r["sequence"].endswith("_" + ending)]
    return statistics.fmean(r["f_score_percent"] for r in rows if r["method"] == f"{fused}, motion {motion}")


def _means(record: dict[str, Any], mm: str, ending: str) -> dict[str, float]:
    """Mean F-scores of what is fused, for the text."""
    mean = partial(_mean, record, ending)
    return {
        f"points_{mm}": mean(POINTS_AT_TRUE_DEPTH, "left in"),
        f"carried_points_{mm}": mean(POINTS_AT_TRUE_DEPTH, "carried to rest"),
        f"static_{mm}": mean(POINTS_OF_TRUE_POSES, "left in"),
        f"run_{mm}": mean("true poses, run's depth", "left in"),
    }


def _costs(record: dict[str, Any], mm: str, ending: str) -> dict[str, float]:
    """Points of F-score that a perfect model of motion is worth, and that a run's poses and depth cost."""
    mean = partial(_mean, record, ending)
    best, poses = (mean(f"{whose} poses, true depth", "carried to rest") for whose in ("true", "run's"))
    depth, left_in = (mean("run's poses, run's depth", motion) for motion in ("carried to rest", "left in"))
    return {
        f"motion_{mm}": best - mean("true poses, true depth", "left in"),
        f"poses_{mm}": best - poses,
        f"depth_{mm}": poses - depth,
        f"carried_{mm}": depth - left_in,
    }


def told(record: dict[str, Any]) -> list[str]:
    """One line a film: how far the wall moved, what the map missed, and what is told."""
    return [
        f"| {r['sequence'][0]} | {AMPLITUDES[r['sequence'].split('_')[1]]} | {r['moved_median_mm']:.2f}, "
        f"{r['moved_90_mm']:.2f} | {r['missed_median_mm']:.2f}, {r['missed_90_mm']:.2f} | "
        f"{r['explained_percent']:.1f} | {'told' if r['told'] else 'not told'} |"
        for r in sorted(record["runs"], key=_order)
    ]


def page(record: dict[str, Any], ceiling: dict[str, Any], motion: dict[str, Any]) -> str:
    """The whole page."""
    rows = sorted(record["runs"], key=_order)
    commits = {row["method"].split(",")[0]: row["commit"][:7] for row in rows}
    versions = sorted(commits, reverse=True)
    lines = [
        "",
        "## By amplitude",
        "",
        "| amplitude (mm) | version | films finished | ATE: mean, median, worst (mm) | frames posed: mean, least (%) "
        "| F-score: mean, median, least (%) |",
        "|---|---|---|---|---|---|",
        *(line for version in versions for line in summary(rows, version)),
        "",
        "; ".join(f"`{version}`: commit {commits[version]}" for version in versions) + ".",
        "",
        "## Film by film",
        "",
        "| path | amplitude (mm) | version | frames posed | submaps | ATE (mm) | rotation over 40 frames (deg) "
        "| F-score (%) | map of | seconds |",
        "|---|---|---|---|---|---|---|---|---|---|",
        *map(row_of, rows),
    ]
    return HEAD.format(**record["environment"]) + "\n".join(lines) + "\n" + READ + _explained(ceiling, motion) + TRIED


def _explained(ceiling: dict[str, Any], motion: dict[str, Any]) -> str:
    """Ceilings, and what becomes of the motion."""
    commits = {
        name: ", ".join(sorted({r["commit"][:7] for r in of["runs"]})) for name, of in zip("cm", (ceiling, motion))
    }
    moving, still = (
        [r["told"] for r in motion["runs"] if r["sequence"].endswith("_0.0") == at_rest] for at_rest in (False, True)
    )
    costs = {k: v for mm, ending in (("5", "5.0"), ("10", "10")) for k, v in _costs(ceiling, mm, ending).items()}
    for mm, ending in (("2.5", "2.5"), ("5", "5.0"), ("10", "10")):
        costs |= _means(ceiling, mm.replace(".", "_"), ending)
    return CEILINGS.format(rows="\n".join(ceilings(ceiling)), commit=commits["c"], **costs) + TOLD.format(
        rows="\n".join(told(motion)),
        commit=commits["m"],
        told=sum(moving),
        moving=len(moving),
        still_told=sum(still),
        still=len(still),
    )


if __name__ == "__main__":
    print(page(*(json.loads((RECORDS / name).read_text()) for name in NAMES)), end="")
