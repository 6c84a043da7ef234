"""How plain COLMAP fares on the phantom's evaluation sequences, beside a sequence that the phantom did not make.

    haustra phantom SUITE --suite
    python -m benchmarks.reconstruction phantom-sfm SUITE/* ../shared/data/ctcolon --json phantom_sfm.json

A phantom that is much easier or much harder than real video would make every later benchmark on it worthless. Both of
COLMAP's mappers get the same SIFT features (peak threshold 0.002, at most 2048) and the same verified matches of each
frame with the eight that follow, and the true camera. Per mapper: the share of all frames that the largest model
registers, the number of models, and that model's errors after Sim(3) alignment of the registered frames' centres. One
run of each mapper: no spread. `moving` is the median motion of a verified match from one frame to the next.
"""

import argparse
import tempfile
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2  # before pycolmap: see pipeline/frontend/colmap/worker.py
import numpy as np
import pycolmap

from benchmarks.common.colmap_features import extract_and_match
from benchmarks.common.runner import add_folders
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.evaluation.trajectory_metrics import trajectory_errors

DARKEST = 12  # of 255: pixels that never get brighter lie outside the border mask


def border_mask(images: list[Path], target: Path) -> Path:
    """PNG that is white where any frame shows a picture, shrunk by 5 px."""
    brightest = np.max([cv2.imread(str(path)).max(axis=-1) for path in images], axis=0)
    mask = np.where(brightest > DARKEST, 255, 0).astype(np.uint8)
    padded = cv2.copyMakeBorder(mask, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=255)
    cv2.imwrite(str(target), cv2.erode(padded, np.ones((11, 11), np.uint8))[1:-1, 1:-1])
    return target


def match(folder: Path, database: Path, mask: Path) -> dict[str, float]:
    """Features and sequential matches; returns the median number of keypoints per frame."""
    extract_and_match(folder, database, mask)
    with pycolmap.Database.open(database) as db:
        images = sorted(db.read_all_images(), key=lambda image: image.name)
        keypoints = [np.asarray(db.read_keypoints(image.image_id))[:, :2] for image in images]
        pairs = [db.read_two_view_geometry(a.image_id, b.image_id).inlier_matches for a, b in pairwise(images)]
    moved = [np.linalg.norm(a[m[:, 0]] - b[m[:, 1]], axis=1) for (a, b), m in zip(pairwise(keypoints), pairs) if len(m)]
    return {
        "keypoints_per_frame": float(np.median([len(found) for found in keypoints])),
        "inliers_per_pair": float(np.median([len(matches) for matches in pairs])),
        "pixels_per_frame": float(np.median([np.median(motion) for motion in moved])),
        "weakest_pair": float(min(len(matches) for matches in pairs)),
    }


def map_both(folder: Path, database: Path, out: Path) -> dict[str, Any]:
    globally, stepwise = pycolmap.GlobalPipelineOptions(), pycolmap.IncrementalPipelineOptions()
    refinement = globally.mapper.bundle_adjustment
    refinement.refine_focal_length = refinement.refine_extra_params = False
    refinement.ceres.use_gpu = globally.mapper.global_positioning.use_gpu = False
    stepwise.ba_refine_focal_length = stepwise.ba_refine_extra_params = False
    results = {}
    for name, mapper, options in (
        ("global", pycolmap.global_mapping, globally),
        ("incremental", pycolmap.incremental_mapping, stepwise),
    ):
        (out / name).mkdir()
        results[name] = judge(mapper(database, folder / "rgb", out / name, options), folder)
    return results


def judge(models: dict[int, pycolmap.Reconstruction], folder: Path) -> dict[str, Any]:
    """Share of the largest model and its errors against the truth."""
    _, truth = read_tum(folder / "trajectory.txt")
    if not models:
        return {"models": 0, "registered_share": 0.0}
    largest = max(models.values(), key=lambda model: model.num_reg_images())
    posed = {int(Path(image.name).stem): image for image in largest.images.values() if image.has_pose}
    frames = sorted(posed)
    result: dict[str, Any] = {"models": len(models), "registered": len(frames), "frames": len(truth)}
    result["registered_share"] = len(frames) / len(truth)
    if len(frames) >= 3:
        estimated = np.tile(np.eye(4), (len(frames), 1, 1))
        estimated[:, :3] = [posed[frame].cam_from_world().inverse().matrix() for frame in frames]
        errors = trajectory_errors(estimated, truth[frames])
        path_mm = np.linalg.norm(np.diff(truth[frames, :3, 3], axis=0), axis=1).sum()
        result |= {
            "ate_mm": errors.ate_rmse,
            "ate_percent_of_path": 100 * errors.ate_rmse / path_mm,
            "rotation_deg": errors.rotation_median_deg,
        }
    return result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser)
    parser.add_argument("--seed", type=int, default=0)


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Both mappers once on each folder."""
    figures: dict[str, Any] = {}
    pycolmap.logging.minloglevel = 2  # errors only
    for folder in arguments.folders:
        pycolmap.set_random_seed(arguments.seed)
        with tempfile.TemporaryDirectory() as scratch:
            out = Path(scratch)
            mask = border_mask(sorted((folder / "rgb").glob("*.png")), out / "mask.png")
            matched = match(folder, out / "database.db", mask)
            figures[folder.name] = matched | map_both(folder, out / "database.db", out)
        print_sequence(folder.name, figures[folder.name])
    return {"seed": arguments.seed, "figures": figures}


def print_sequence(name: str, figures: dict[str, Any]) -> None:
    print(f"{name:18} {figures['keypoints_per_frame']:5.0f} keypoints/frame", end="")
    print(f", {figures['inliers_per_pair']:4.0f} inliers with the next (least {figures['weakest_pair']:.0f})", end="")
    print(f", moving {figures['pixels_per_frame']:.1f} px", end="")
    for mapper in ("global", "incremental"):
        found = figures[mapper]
        errors = f"ATE {found['ate_mm']:.3f} mm, {found['rotation_deg']:.2f} deg" if "ate_mm" in found else "no model"
        count = f"{found.get('registered', 0)}/{found.get('frames', 0)} in {found['models']}"
        print(f" | {mapper} {count}, {errors}", end="")
    print(flush=True)
