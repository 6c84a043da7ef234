"""How well the lamp is divided out: one place of the wall in two pictures should have one colour.

    python -m benchmarks.delighting RUN RGBD_FOLDER --json delighting.json

RUN is a finished run of the folder's frames (pinhole camera); up to 24 of its keyframes, each with the three after it.
Every fourth pixel of one is carried into the other by *true* depth and poses; kept where it meets the true depth there
to 2 %, neither pixel is burnt or black as filmed, and the distance has changed by a tenth or more, since otherwise
there is nothing to take out. Printed: the median of |ln of the luminances' ratio|

  as filmed                 what the mesh's colours are made of without de-lighting
  frame's gain alone        each frame brought to the film's median, nothing else
  completed depth           `Lamp.delit` as the pipeline calls it
  ... without slant         the same with the slant's exponent 0
  true depth                the same from true depth: what better completion could give

each twice: as it is, which is what shows in the mesh, and with each pair's median ratio removed, which leaves what
varies within a picture.
"""

import argparse
import dataclasses
from pathlib import Path

import cv2
import numpy as np

from benchmarks.record import write
from pipeline.depth.completion_stage import planned_keyframes
from pipeline.frontend.select import load_structure
from pipeline.input.frames import load_frames
from pipeline.loop_closing.close_loops import refined_keyframes
from pipeline.run_folder.workspace import open_workspace
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.fusion.photometry import BURNT, DARK, GAMMA, LUMA, MIN_COSINE, Lamp, fit_lamp, geometry

KEYFRAMES, AFTER, STRIDE = 24, 3, 4
SAME, CHANGED = 0.02, 0.1  # relative: depth that meets the truth, distance that has changed
UNIT_MM = 0.01  # a step of the depth PNG in every RGB-D folder that the phantom writes
MIN_PLACES = 50  # of a pair
Pair = tuple[int, int, np.ndarray, np.ndarray]  # keyframes, flat pixels in the one and the other


def same_places(depths: list[np.ndarray], poses: list[np.ndarray], fair: list[np.ndarray], k: np.ndarray) -> list[Pair]:
    """Pixels of one place in two pictures, by true depth and poses (mm)."""
    found = []
    for one in range(len(depths)):
        for other in range(one + 1, min(one + 1 + AFTER, len(depths))):
            first, second = _carried(depths[one], depths[other], poses[one], poses[other], k)
            kept = fair[one].ravel()[first] & fair[other].ravel()[second]
            if kept.sum() >= MIN_PLACES:
                found.append((one, other, first[kept], second[kept]))
    return found


def _carried(
    depth: np.ndarray, other: np.ndarray, pose: np.ndarray, other_pose: np.ndarray, k: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    row, column = np.nonzero(depth[::STRIDE, ::STRIDE])
    row, column = row * STRIDE, column * STRIDE
    ray = np.stack([column + 0.5, row + 0.5, np.ones(len(row))]) * depth[row, column]
    world = (np.linalg.inv(k) @ ray).T @ pose[:3, :3].T + pose[:3, 3]
    there = (world - other_pose[:3, 3]) @ other_pose[:3, :3]
    x, y, z = (there @ k.T).T
    u, v = np.floor(x / np.maximum(z, 1e-9)).astype(int), np.floor(y / np.maximum(z, 1e-9)).astype(int)
    height, width = depth.shape
    inside = (z > 0) & (u >= 0) & (v >= 0) & (u < width) & (v < height)
    row, column, u, v, z, there = row[inside], column[inside], u[inside], v[inside], z[inside], there[inside]
    far = np.linalg.norm(world[inside] - pose[:3, 3], axis=1)
    changed = np.abs(np.log(np.linalg.norm(there, axis=1) / far)) > CHANGED
    kept = (np.abs(other[v, u] / z - 1) < SAME) & changed
    return (row * width + column)[kept], (v * width + u)[kept]


def difference(pictures: list[np.ndarray], pairs: list[Pair]) -> dict[str, float]:
    """Median |ln ratio| of luminance over all places, as it is and with each pair's median removed."""
    bright = [np.log(np.maximum(((p / 255.0) ** GAMMA) @ LUMA, 1e-4)).ravel() for p in pictures]
    ratios = [bright[one][first] - bright[other][second] for one, other, first, second in pairs]
    centred = [ratio - np.median(ratio) for ratio in ratios]
    return {
        "as_it_is": float(np.median(np.abs(np.concatenate(ratios)))),
        "pair_removed": float(np.median(np.abs(np.concatenate(centred)))),
    }


def with_exponents(lamp: Lamp, rgbs: list[np.ndarray], depths: list[np.ndarray], k: np.ndarray, **exponents) -> Lamp:
    """The lamp with other exponents, and the level that belongs to them."""
    changed = dataclasses.replace(lamp, **exponents, level=0.0)
    gains = [changed.gain(rgb, depth, k) for rgb, depth in zip(rgbs, depths, strict=True)]
    return dataclasses.replace(changed, level=float(np.mean([g for g in gains if g is not None])))


def judge(run: Path, folder: Path) -> dict[str, object]:
    workspace = open_workspace(run)
    planned = planned_keyframes(load_frames(workspace), load_structure(workspace), workspace)
    part = refined_keyframes(planned, workspace)[0]
    _, truth = read_tum(folder / "trajectory.txt")
    k = part.camera.matrix
    chosen = [part.keyframe(int(row)) for row in part.rows[:: max(1, len(part.rows) // KEYFRAMES)]]
    rgbs, depths = [c.rgb for c in chosen], [c.depth for c in chosen]
    raw = [cv2.imread(str(folder / "depth" / f"{c.index:05d}.png"), cv2.IMREAD_UNCHANGED) for c in chosen]
    true = [image.astype(np.float32) * np.float32(UNIT_MM) for image in raw]
    fair = [
        (rgb.max(axis=-1) < BURNT) & (rgb.max(axis=-1) > DARK) & (geometry(depth, k, 0)[1] > MIN_COSINE)
        for rgb, depth in zip(rgbs, true, strict=True)
    ]
    pairs = same_places(true, [truth[c.index] for c in chosen], fair, k)
    lamp, best = fit_lamp(zip(rgbs, depths, strict=True), k), fit_lamp(zip(rgbs, true, strict=True), k)
    assert lamp is not None
    assert best is not None

    def delit(of: Lamp, by: list[np.ndarray]) -> dict[str, float]:
        return difference([of.delit(rgb, depth, k) for rgb, depth in zip(rgbs, by, strict=True)], pairs)

    return {
        "keyframes": len(chosen),
        "pairs": len(pairs),
        "places": sum(len(pair[2]) for pair in pairs),
        "exponents": {
            "completed": [lamp.distance, lamp.slant, lamp.axis],
            "true": [best.distance, best.slant, best.axis],
        },
        "as filmed": difference(rgbs, pairs),
        "frame's gain alone": delit(with_exponents(lamp, rgbs, depths, k, distance=0.0, slant=0.0, axis=0.0), depths),
        "completed depth": delit(lamp, depths),
        "completed depth, without slant": delit(with_exponents(lamp, rgbs, depths, k, slant=0.0), depths),
        "true depth": delit(best, true),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    figures = judge(arguments.run, arguments.folder)
    print(f"{figures['places']} places in {figures['pairs']} pairs of {figures['keyframes']} keyframes")
    for name, exponents in figures["exponents"].items():
        print(f"exponents from {name} depth: " + ", ".join(f"{e:.2f}" for e in exponents))
    for name, of in figures.items():
        if isinstance(of, dict) and "as_it_is" in of:
            print(f"{name:32} {of['as_it_is']:.3f}   pair's median removed {of['pair_removed']:.3f}")
    write(arguments.json, {"figures": figures})


if __name__ == "__main__":
    main()
