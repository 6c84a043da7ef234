"""How far off the sparse points of finished runs are, and how far off they say they are, in each kind of point.

    python -m benchmarks.sparse_points RUNS/ctcolon=DATA/ctcolon RUNS/flexure=SUITE/flexure --json points.json

RUN must be a finished run of the RGB-D folder's frames. A point's depth in each keyframe that saw it is compared with
the true depth at its pixel, after the one scale of the path. `found`: features that each keyframe found for itself;
`followed`: corners that were followed from frame to frame. Errors are relative. `ratio`: median of error over claimed
error, over that of a normal distribution (0.6745): one if the claim is right. `slide_px`: the pixels by which followed
corners would have to slide to be off as they are, median of error times focal length times angle spanned, over 0.6745.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.fusion_depths import KeyframeView, true_depth
from benchmarks.fusion_input import pair
from benchmarks.fusion_parts import MeasuredRun
from benchmarks.record import write
from pipeline.depth.sparse_depth import SparseDepthMaker

NORMAL_MEDIAN = 0.6745  # of |N(0,1)|
GROSS = 0.1  # relative


def observed(view: KeyframeView, maker: SparseDepthMaker, row: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Points (K,) that the keyframe saw and whose true depth is known, and their relative depth errors (K,)."""
    points = maker.seen_by(row)
    local = maker.submap.points_in_camera(row, maker.submap.points[points])
    front = local[:, 2] > 0
    points, local = points[front], local[front]
    x, y = np.floor(maker.pinhole.project(local)).astype(int).T
    truth = true_depth(view)[0] / view.mm_per_unit
    inside = (x >= 0) & (y >= 0) & (x < truth.shape[1]) & (y < truth.shape[0])
    known = np.zeros(len(points))
    known[inside] = truth[y[inside], x[inside]]
    has = known > 0
    return points[has], np.abs(local[has, 2] / known[has] - 1)


def measure(run: MeasuredRun) -> dict[str, Any]:
    part = run.before.part
    maker = SparseDepthMaker(part.submap, part.camera, run.config.sparse)
    found = [observed(run.views[int(part.submap.frames[row])], maker, int(row)) for row in part.rows]
    points, off = np.concatenate([p for p, _ in found]), np.concatenate([e for _, e in found])
    followed = part.submap.is_followed[points]
    angle = np.radians(part.submap.triangulation_angles())[points]
    result: dict[str, Any] = {"keyframes": len(found)}
    for kind, mine in (("followed", followed), ("found", ~followed)):
        if not mine.any():
            continue
        result[kind] = {
            "per_keyframe": int(mine.sum()) / len(found),
            "error_percent": 100 * float(np.median(off[mine])),
            "claimed_percent": 100 * float(np.median(maker.error[points[mine]])),
            "ratio": float(np.median(off[mine] / maker.error[points[mine]])) / NORMAL_MEDIAN,
            "over_a_tenth_percent": 100 * float((off[mine] > GROSS).mean()),
        }
    if followed.any():
        slide = off[followed] * part.submap.camera_params[0] * angle[followed]
        result["followed"]["slide_px"] = float(np.median(slide)) / NORMAL_MEDIAN
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("pairs", metavar="RUN=FOLDER", type=pair, nargs="+", help="finished run and its RGB-D folder")
    parser.add_argument("--json", type=Path, help="written anew after each run")
    arguments = parser.parse_args()
    runs: dict[str, Any] = {}
    for run, folder in arguments.pairs:
        opened = MeasuredRun(run, folder)
        runs[opened.name] = measure(opened)
        for kind, figures in runs[opened.name].items():
            shown = figures if kind == "keyframes" else ", ".join(f"{k} {v:.2f}" for k, v in figures.items())
            print(f"{opened.name}: {kind}: {shown}", flush=True)
        write(arguments.json, {"runs": runs})


if __name__ == "__main__":
    main()
