"""Submaps of one film with frames missing in the middle: are they joined, and rightly? And are other films' never?

    python -m benchmarks.loops joins SUITE/* ../shared/data/ctcolon --gaps 10 20 40 --json joins.json

Of each RGB-D folder the middle frames are left out, as a red-out would; either part is tracked for itself and adjusted
to its features, as `odometry` does, and the maps are joined where the evidence allows. Way: the length that the camera
truly went in the gap, in mm and in median depths of the frame before it. Maps: on either side -> left. Scale error: of
the similarity between the largest map on either side, where they are linked, against the quotient of their Sim(3)s to
truth. ATE: RMSE of the centres of the largest map that is left, after one Sim(3). Then every largest first part is
offered to every second part of another film: each join of these is false, whatever it looks like.
"""

import argparse
import copy
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.common.front_end import store, tracked_maps
from benchmarks.common.runner import add_folders
from haustra.core.progress import SilentProgress
from haustra.core.sim3 import scale_of
from pipeline.config import Config
from pipeline.frontend.odometry.frame_io import frame_reader
from pipeline.input.frames import Frames
from pipeline.mapping.final_adjustment import adjust_maps
from pipeline.mapping.local_map import LocalMap
from pipeline.mapping.submap_matching import (
    MapFeatures,
    consistent_matches,
    features_of_map,
    find_matches,
    joint_similarity,
)
from pipeline.mapping.submap_merging import merge_and_adjust
from pipeline.mapping.submap_of_map import to_submap
from pipeline.matching.place_recognition import VisualWords
from pipeline.matching.sift import FindFeatures
from pipeline.matching.sift_cache import ReadFrame, SiftCache
from reconstruction.evaluation.trajectory_io import read_tum
from reconstruction.evaluation.trajectory_metrics import align_poses, trajectory_errors

Held = tuple[LocalMap, float | None]  # and how wide the features that moved it were; None where they do not hold it


@dataclass(frozen=True)
class Film:
    name: str
    frames: Frames
    features: SiftCache
    read: ReadFrame
    truth: np.ndarray


def film_of(folder: Path, scratch: Path) -> Film:
    frames, workspace = store(folder, Config(front_end="odometry"), scratch / folder.name)
    _, truth = read_tum(folder / "trajectory.txt")
    read = frame_reader(workspace)
    return Film(folder.name, frames, SiftCache(read), read, truth)


def tracked(film: Film, completed: np.ndarray) -> list[Held]:
    """The maps of some of the frames, adjusted, most keyframes first."""
    maps = tracked_maps(film.frames.camera, film.read, completed)
    held = zip(maps, adjust_maps(maps, film.features, SilentProgress()), strict=True)
    return sorted((h for h in held if to_submap(h[0], h[0].rays.camera.params)), key=lambda h: -len(h[0].keyframes))


def parts_without(film: Film, gap: int) -> tuple[np.ndarray, np.ndarray]:
    """The film's frames before and after the `gap` ones in its middle."""
    index = film.frames.index
    return index[: (len(index) - gap) // 2], index[(len(index) + gap) // 2 :]


def scale_error_percent(second_from_first: np.ndarray, truth_from: list[np.ndarray]) -> float:
    """Of a similarity between two maps, by where the truth has either."""
    true_scale = scale_of(truth_from[0]) / scale_of(truth_from[1])
    return float(100 * (scale_of(second_from_first) / true_scale - 1))


def truth_from_map(local_map: LocalMap, truth: np.ndarray) -> np.ndarray:
    submap = to_submap(local_map, local_map.rays.camera.params)
    assert submap is not None
    return align_poses(submap.world_from_camera, truth[submap.frames])


def offered(first: LocalMap, second: LocalMap, finders: tuple[FindFeatures, FindFeatures]) -> np.ndarray | None:
    """`second_from_first` if the evidence is enough for a join."""
    a, b = (MapFeatures(m, features_of_map(m, find)) for m, find in zip((first, second), finders, strict=True))
    words = VisualWords.of([*a.features, *b.features], 0)
    matches = consistent_matches(find_matches((a, b), np.random.default_rng(0), words), (a, b))
    return joint_similarity(matches, (a, b)) if matches else None


def cut(film: Film, gap: int) -> tuple[dict[str, Any], tuple[LocalMap, LocalMap] | None]:
    """What becomes of the film without `gap` frames in its middle; the largest map on either side."""
    before, after = parts_without(film, gap)
    way = np.linalg.norm(np.diff(film.truth[before[-1] : after[0] + 1, :3, 3], axis=0), axis=1).sum()
    maps = tracked(film, before), tracked(film, after)
    result: dict[str, Any] = {"film": film.name, "gap": gap, "way_mm": float(way), "maps": [len(m) for m in maps]}
    if not all(maps):
        return result, None
    first, second = maps[0][0][0], maps[1][0][0]
    to_truth = [truth_from_map(m, film.truth) for m in (first, second)]
    result["way_depths"] = float(way / (first.median_depth(first.keyframes[-1]) * scale_of(to_truth[0])))
    found = offered(first, second, (film.features, film.features))
    if found is not None:
        result["scale_error_percent"] = scale_error_percent(found, to_truth)
    return result | joined(film, copy.deepcopy(maps[0] + maps[1])), (first, second)


def joined(film: Film, held: list[Held]) -> dict[str, Any]:
    """How many maps are left of all, and the path errors of the largest; the maps are used up."""
    maps, by = map(list, zip(*held, strict=True))
    left, _ = merge_and_adjust(maps, by, film.features, 0, SilentProgress())
    submaps = [to_submap(m, m.rays.camera.params) for m in left]
    submap = max((s for s in submaps if s is not None), key=lambda s: len(s.frames))
    errors = trajectory_errors(submap.world_from_camera, film.truth[submap.frames])
    about = {"left": len(left), "posed": len(submap.frames)}
    return about | {"ate_mm": errors.ate_rmse, "rotation_deg": errors.rotation_median_deg}


def print_cut(row: dict[str, Any]) -> None:
    text = f"{row['film']:16} gap {row['gap']:3} frames, {row['way_mm']:.1f} mm"
    if "left" not in row:
        print(text + ": no map on one side", flush=True)
        return
    text += f" ({row['way_depths']:.2f} depths), maps {row['maps'][0]} + {row['maps'][1]} -> {row['left']}"
    if "scale_error_percent" in row:
        text += f", scale {row['scale_error_percent']:+.1f} %"
    print(text + f"; largest: ATE {row['ate_mm']:.3f} mm of {row['posed']} frames", flush=True)


Halves = dict[str, tuple[LocalMap, LocalMap]]  # by film: the largest map before the gap, and after it


def cut_films(films: list[Film], gaps: list[int]) -> tuple[list[dict[str, Any]], Halves]:
    """A row for each film and gap; the maps beside the smallest gap."""
    rows, halves = [], {}
    for film in films:
        for gap in gaps:
            row, pair = cut(film, gap)
            if gap == min(gaps) and pair is not None:
                halves[film.name] = pair
            rows.append(row)
            print_cut(row)
    return rows, halves


def joined_strangers(films: list[Film], halves: Halves) -> tuple[list[tuple[str, str]], int]:
    """Of the pairs of one film's first part and another's second, those that would be joined; how many pairs."""
    finders = {film.name: film.features for film in films}
    pairs = [(a, b) for a in halves for b in halves if a != b]
    false = [(a, b) for a, b in pairs if offered(halves[a][0], halves[b][1], (finders[a], finders[b])) is not None]
    print(f"parts of different films: {len(false)} joined of {len(pairs)} pairs {false or ''}")
    return false, len(pairs)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_folders(parser)
    parser.add_argument("--gaps", type=int, nargs="+", default=[10, 20, 40], help="frames left out")


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Each film cut at each gap, then the parts of different films."""
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as scratch:
        films = [film_of(folder, Path(scratch)) for folder in arguments.folders]
        rows, halves = cut_films(films, arguments.gaps)
        false, pairs = joined_strangers(films, halves)
    return {"gaps": arguments.gaps, "rows": rows, "strangers": pairs, "false": false}
