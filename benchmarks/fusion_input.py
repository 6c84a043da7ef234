"""What the depth is worth to the mesh: one run's poses fused with linear interpolation, completion, and true depth.

    python benchmarks/fusion_input.py RUN RGBD_FOLDER --model mscsa --model W.safetensors --json fusion_input.json

RUN must be a finished run of the folder's frames. All are fused by the same code and ranges, at the same keyframes and
poses; the surfaces are compared as `haustra compare` does. `the run's own` is the depth that the run wrote; each
`--model` completes the same sparse points anew. Each is fused with and without its confidence, and with and without the
consistency check. Linear: Delaunay interpolation of each keyframe's sparse depth, nothing
outside the hull. True depth is divided by the scale of the path.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from scipy.interpolate import LinearNDInterpolator

from completion import DepthCompleter
from pipeline.camera import read_camera
from pipeline.config import Config
from pipeline.consistency import ConsistencyCheck
from pipeline.dense import DenseSubmap, Keyframe, planned_keyframes
from pipeline.frames import load_frames
from pipeline.refinement import refined_keyframes
from pipeline.sparse_depth import SparseDepthMaker
from pipeline.structure import load_structure
from pipeline.surface import fusion_settings
from pipeline.workspace import open_workspace
from reconstruction.fusion import SurfaceFusion
from reconstruction.mesh import drop_small_components
from reconstruction.observed_truth import observed_truth
from reconstruction.surface_metrics import surface_errors
from reconstruction.trajectory import align_poses, associate, read_tum
from record import write

Source = Callable[[int, Keyframe], tuple[np.ndarray, np.ndarray | None]]


def linear_depth(maker: SparseDepthMaker, row: int, shape: tuple[int, int]) -> np.ndarray:
    sparse = maker.sparse_depth(row)
    rows, columns = np.indices(shape) + 0.5
    return LinearNDInterpolator(sparse.pixels, sparse.depth, fill_value=0)(columns, rows).astype(np.float32)


def true_depth(folder: Path, index: int, scale: float) -> np.ndarray:
    """In scene units; the unit of the PNG is 0.01 mm in every RGB-D folder that the phantom writes."""
    image = cv2.imread(str(folder / "depth" / f"{index:05d}.png"), cv2.IMREAD_UNCHANGED)
    return image.astype(np.float32) * np.float32(0.01 / scale)


def completed(model: str, maker: SparseDepthMaker) -> Source:
    """The depth that a model makes of the run's sparse points."""
    completer = DepthCompleter.load(model)

    def depth(row: int, keyframe: Keyframe) -> tuple[np.ndarray, np.ndarray]:
        known = keyframe.depth > 0  # the run leaves out what is outside the picture
        depth, confidence = completer(keyframe.rgb, *maker.sparse_depth(row).maps(*known.shape))
        return np.where(known, depth, 0), confidence

    return depth


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--model", action="append", default=[], help="shipped name or weight file; may be repeated")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    workspace = open_workspace(arguments.run)
    frames, config = load_frames(workspace), workspace.config
    part = refined_keyframes(planned_keyframes(frames, load_structure(workspace), workspace), workspace)[0]
    seconds, poses = read_tum(arguments.folder / "trajectory.txt")
    mine = np.array([frames.seconds_of(int(index)) for index in part.submap.frames])
    pairs = associate(mine, seconds, 0.5 * float(np.median(np.diff(seconds))))
    truth_from_run = align_poses(part.submap.world_from_camera[pairs[0]], poses[pairs[1]])
    scale = float(np.cbrt(np.linalg.det(truth_from_run[:3, :3])))
    maker = SparseDepthMaker(part.submap, part.camera, config.sparse)
    shape = (read_camera(workspace.camera).height, part.camera.width)
    sources: dict[str, Source] = {
        "linear": lambda row, keyframe: (linear_depth(maker, row, shape), None),
        "the run's own": lambda row, keyframe: (keyframe.depth, keyframe.confidence),
        **{f"model {model}": completed(model, maker) for model in arguments.model},
        "true depth": lambda row, keyframe: (true_depth(arguments.folder, keyframe.index, scale), None),
    }
    truth, figures = observed_truth(arguments.folder), {}
    keyframes = [part.keyframe(int(row)) for row in part.rows]
    for name, source in sources.items():
        made = [source(int(row), keyframe) for row, keyframe in zip(part.rows, keyframes, strict=True)]
        for weights, confidences in weighted(made, part, keyframes, config).items():
            fusion = SurfaceFusion(fusion_settings(part, config))
            for keyframe, (depth, _), confidence in zip(keyframes, made, confidences, strict=True):
                fusion.integrate(keyframe.rgb, depth, confidence, part.camera.matrix, keyframe.world_from_camera)
            mesh = drop_small_components(fusion.extract(), config.fusion.min_component)[0].transformed(truth_from_run)
            errors = surface_errors(mesh, truth, 1.0, np.random.default_rng(0))
            figure = {"f_score": errors.f_score, "precision": errors.precision, "recall": errors.recall}
            figures[f"{name}, {weights}"] = figure
            print(f"{name:14} {weights:28} {errors}", flush=True)
    write(arguments.json, {"run": arguments.run.name, "keyframes": len(part), "figures": figures})


def weighted(
    made: list[tuple[np.ndarray, np.ndarray | None]], part: DenseSubmap, keyframes: list[Keyframe], config: Config
) -> dict[str, list[np.ndarray]]:
    """Confidences to fuse with: none, the depth's own where it has one, and either lowered by the neighbours."""
    fused = FusedFrames(part, keyframes, made)
    check = ConsistencyCheck(fused, config.consistency, config.fusion.min_confidence)
    known = [(depth > 0).astype(np.float32) for depth, _ in made]
    variants = {"no confidence": known}
    if all(confidence is not None for _, confidence in made):
        floor = config.fusion.min_confidence
        variants["confidence"] = [np.where(c < floor, 0, c).astype(np.float32) for _, c in made]
    lowered = {}
    for name, confidences in variants.items():
        judged = (check.confidence(place, confidence) for place, confidence in enumerate(confidences))
        lowered[f"{name} + consistency"] = [np.zeros_like(k) if c is None else c for c, k in zip(judged, known)]
    return variants | lowered


class FusedFrames:
    """A submap's keyframes with another depth, as far as the consistency check looks at them."""

    def __init__(
        self, part: DenseSubmap, keyframes: list[Keyframe], made: list[tuple[np.ndarray, np.ndarray | None]]
    ) -> None:
        self.camera, self.rows = part.camera, np.arange(len(keyframes))
        self._made, self._poses = made, [keyframe.world_from_camera for keyframe in keyframes]

    def __len__(self) -> int:
        return len(self.rows)

    def depth(self, row: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        depth, confidence = self._made[row]
        sure = np.ones_like(depth) if confidence is None else confidence
        return depth.astype(np.float32), sure, self._poses[row]


if __name__ == "__main__":
    main()
