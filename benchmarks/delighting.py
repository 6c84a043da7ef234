"""How well the lamp is divided out: one place of the wall in two pictures should have one colour.

    python benchmarks/delighting.py FOLDERS... --json delighting.json

RGB-D folders with true depth and poses. Pairs of frames 5, 10 and 20 apart: every fourth pixel of one is carried into
the other by the true depth; kept where it meets the true depth there to 2 %, neither pixel is burnt or black, and the
distance has changed by a tenth or more, since otherwise there is nothing to take out. Printed: the median of |ln of the
luminances' ratio| as filmed; with each frame's gain removed (the median ratio of the pair), which is the fair rival;
with the lamp removed by the textbook's exponents (-2, 1, 0); and by the exponents fitted to the film. In all but the
first the pair's median ratio is removed.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np

from pipeline.camera import read_camera
from reconstruction.lamp import BURNT, DARK, GAMMA, LUMA, MIN_COSINE, Lamp, fit_lamp, geometry
from reconstruction.trajectory import read_tum
from record import write

APART, STRIDE = (5, 10, 20), 4
SAME, CHANGED = 0.02, 0.1  # relative: depth that meets the truth, distance that has changed
TEXTBOOK, NONE = (-2.0, 1.0, 0.0), (0.0, 0.0, 0.0)


def read(folder: Path, index: int) -> tuple[np.ndarray, np.ndarray]:
    """Picture and true depth in the PNG's unit, which drops out."""
    rgb = cv2.cvtColor(cv2.imread(str(folder / "rgb" / f"{index:05d}.png")), cv2.COLOR_BGR2RGB)
    return rgb, cv2.imread(str(folder / "depth" / f"{index:05d}.png"), cv2.IMREAD_UNCHANGED).astype(np.float32)


def observed(rgb: np.ndarray, depth: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """(H,W,4) ln luminance, and what it depends on; NaN where a pixel tells nothing."""
    distance, cosine, ahead = geometry(depth, intrinsics)
    bright = rgb.max(axis=-1)
    fair = (distance > 0) & (cosine > MIN_COSINE) & (bright < BURNT) & (bright > DARK)
    values = np.stack([((rgb / 255.0) ** GAMMA) @ LUMA, distance, cosine, ahead], axis=-1)
    return np.log(np.where(fair[..., None], values, np.nan))


def matched(first: tuple, second: tuple, intrinsics: np.ndarray, unit: float) -> np.ndarray:
    """(N,2,4) what the same places of the wall looked like in both; each side (picture, depth, pose in `unit`)."""
    (rgb, depth, pose), (other_rgb, other_depth, other_pose) = first, second
    row, column = np.nonzero(depth[::STRIDE, ::STRIDE])
    row, column = row * STRIDE, column * STRIDE
    ray = np.stack([column + 0.5, row + 0.5, np.ones(len(row))]) * depth[row, column]
    local = (np.linalg.inv(intrinsics) @ ray).T * unit
    world = local @ pose[:3, :3].T + pose[:3, 3]
    there = (world - other_pose[:3, 3]) @ other_pose[:3, :3] / unit
    x, y, z = (there @ intrinsics.T).T
    u, v = np.floor(x / np.maximum(z, 1e-9)).astype(int), np.floor(y / np.maximum(z, 1e-9)).astype(int)
    inside = (z > 0) & (u >= 0) & (v >= 0) & (u < depth.shape[1]) & (v < depth.shape[0])
    row, column, u, v, z = row[inside], column[inside], u[inside], v[inside], z[inside]
    met = np.abs(other_depth[v, u] / z - 1) < SAME
    pairs = np.stack(
        [observed(rgb, depth, intrinsics)[row, column], observed(other_rgb, other_depth, intrinsics)[v, u]]
    )
    pairs = np.swapaxes(pairs, 0, 1)[met]
    pairs = pairs[np.isfinite(pairs).all(axis=(1, 2))]
    return pairs[np.abs(pairs[:, 0, 1] - pairs[:, 1, 1]) > CHANGED]


def differences(pairs: list[np.ndarray], exponents: tuple[float, ...], centred: bool = True) -> np.ndarray:
    """|ln ratio| of all matched places once the exponents are applied."""
    found = []
    for pair in pairs:
        bare = pair[:, :, 0] - pair[:, :, 1:] @ np.array(exponents)
        change = bare[:, 0] - bare[:, 1]
        found.append(np.abs(change - np.median(change) if centred else change))
    return np.concatenate(found)


def judge(folder: Path, step: int) -> dict[str, float]:
    camera = read_camera(folder / "camera.json")
    _, poses = read_tum(folder / "trajectory.txt")
    unit = 0.01  # mm in a step of the depth PNG, in every RGB-D folder that the phantom writes
    frames = [(*read(folder, k), poses[k]) for k in range(0, len(poses), step)]
    lamp = fit_lamp([(rgb, depth) for rgb, depth, _ in frames[:: max(1, len(frames) // 60)]], camera.matrix)
    assert isinstance(lamp, Lamp)
    pairs = [
        matched(frames[k], frames[k + apart // step], camera.matrix, unit)
        for apart in APART
        for k in range(0, len(frames) - apart // step, max(1, 10 // step))
    ]
    pairs = [pair for pair in pairs if len(pair) > 50]
    return {
        "pairs": len(pairs),
        "places": sum(map(len, pairs)),
        "distance_exponent": lamp.distance,
        "slant_exponent": lamp.slant,
        "axis_exponent": lamp.axis,
        "as_filmed": float(np.median(differences(pairs, NONE, centred=False))),
        "gain_removed": float(np.median(differences(pairs, NONE))),
        "textbook": float(np.median(differences(pairs, TEXTBOOK))),
        "fitted": float(np.median(differences(pairs, (lamp.distance, lamp.slant, lamp.axis)))),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--step", type=int, default=5, help="frames between those that are read")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    figures = {folder.name: judge(folder, arguments.step) for folder in arguments.folders}
    for name, of in figures.items():
        print(
            f"{name}: median |ln ratio| as filmed {of['as_filmed']:.3f}, gain removed {of['gain_removed']:.3f}, "
            f"textbook {of['textbook']:.3f}, fitted {of['fitted']:.3f} (exponents {of['distance_exponent']:.2f}, "
            f"{of['slant_exponent']:.2f}, {of['axis_exponent']:.2f}); {of['places']} places in {of['pairs']} pairs"
        )
    write(arguments.json, {"figures": figures})


if __name__ == "__main__":
    main()
