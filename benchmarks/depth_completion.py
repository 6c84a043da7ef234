"""abs.REL of the shipped model beside linear interpolation on folders with true depth.

    python benchmarks/depth_completion.py ../shared/data/ctcolon ../shared/data/simcol3d --json completion.json

Samplers: `uniform` takes pixels at random with true depth. `sfm` takes SIFT keypoints (OpenCV, contrast threshold
0.005) at random, multiplies depth by 1 + 0.03 N(0,1), 3 % of the points by U(0.5, 2), and all points of a frame by
one unknown factor in [e^-2, e^2]. Per frame: mean |p - g| / g over valid pixels, the prediction divided by the known
factor; then the mean over frames. Linear interpolation fills outside the hull with the nearest point.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

from completion import DepthCompleter
from completion.frames import EvaluationFrame
from completion.readers import read_evaluation_frames
from record import write

SETTINGS = (("uniform", 100), ("sfm", 100), ("sfm", 500))


def sample(frame: EvaluationFrame, sampler: str, count: int, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """Sparse depth (H,W) and the factor that it was multiplied by."""
    height, width = frame.depth.shape
    if sampler == "uniform":
        rows, columns = np.unravel_index(rng.permutation(height * width), (height, width))
    else:
        grey = cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2GRAY)
        points = np.array([k.pt for k in cv2.SIFT_create(contrastThreshold=0.005).detect(grey)])
        columns, rows = rng.permutation(points).round().astype(int).T
    keep = frame.depth[rows.clip(0, height - 1), columns.clip(0, width - 1)] > 0
    rows, columns = rows[keep][:count], columns[keep][:count]
    values, factor = frame.depth[rows, columns].copy(), 1.0
    if sampler == "sfm":
        values *= 1 + 0.03 * rng.standard_normal(len(values))
        wrong = rng.random(len(values)) < 0.03
        values[wrong] *= rng.uniform(0.5, 2, wrong.sum())
        factor = float(np.exp(rng.uniform(-2, 2)))
    sparse = np.zeros((height, width), np.float32)
    sparse[rows, columns] = values * factor
    return sparse, factor


def linear(sparse: np.ndarray) -> np.ndarray:
    """Delaunay-linear interpolation, nearest outside the hull."""
    points = np.argwhere(sparse > 0)
    values = sparse[sparse > 0]
    grid = np.indices(sparse.shape).reshape(2, -1).T
    dense = LinearNDInterpolator(points, values)(grid)
    outside = np.isnan(dense)
    dense[outside] = NearestNDInterpolator(points, values)(grid[outside])
    return dense.reshape(sparse.shape)


def absolute_relative(depth: np.ndarray, truth: np.ndarray) -> float:
    valid = truth > 0
    return float(100 * (np.abs(depth - truth)[valid] / truth[valid]).mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--model", default="mscsa")
    parser.add_argument("--stride", type=int, default=4, help="every n-th frame of a long sequence")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    completer = DepthCompleter.load(arguments.model)
    rows = []
    for folder in arguments.folders:
        frames = list(read_evaluation_frames(folder))
        frames = frames if len(frames) <= 20 else frames[:: arguments.stride]
        for sampler, points in SETTINGS:
            rng = np.random.default_rng(0)
            errors = {"linear": [], arguments.model: []}
            for frame in frames:
                sparse, factor = sample(frame, sampler, points, rng)
                errors["linear"].append(absolute_relative(linear(sparse) / factor, frame.depth))
                errors[arguments.model].append(absolute_relative(completer(frame.rgb, sparse)[0] / factor, frame.depth))
            row = {"folder": folder.name, "sampler": sampler, "points": points, "frames": len(frames)}
            row |= {f"{name}_abs_rel_percent": float(np.mean(values)) for name, values in errors.items()}
            rows.append(row)
            print(
                "  ".join(f"{k} {v:.2f}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()),
                flush=True,
            )
    write(arguments.json, {"rows": rows})


if __name__ == "__main__":
    main()
