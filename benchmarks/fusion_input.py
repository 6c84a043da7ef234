"""What the depth is worth to the mesh: one run's poses fused with linear interpolation, completion, and true depth.

    python benchmarks/fusion_input.py RUN RGBD_FOLDER --model mscsa --model W.safetensors --json fusion_input.json

RUN must be a finished run of the folder's frames. All are fused by the same code and ranges, at the same keyframes and
poses; the surfaces are compared as `haustra compare` does. `the run's own` is the depth that the run wrote; each
`--model` completes the same sparse points anew. Linear: Delaunay interpolation of each keyframe's sparse depth, nothing
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
from pipeline.dense import Keyframe, planned_keyframes
from pipeline.frames import load_frames
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
    part = planned_keyframes(frames, load_structure(workspace), workspace)[0]
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
        **{Path(model).stem: completed(model, maker) for model in arguments.model},
        "true depth": lambda row, keyframe: (true_depth(arguments.folder, keyframe.index, scale), None),
    }
    truth, figures = observed_truth(arguments.folder), {}
    for name, source in sources.items():
        fusion = SurfaceFusion(fusion_settings(part, config))
        for row in part.rows:
            keyframe = part.keyframe(int(row))
            depth, confidence = source(int(row), keyframe)
            if confidence is not None:
                confidence = np.where(confidence < config.fusion.min_confidence, 0, confidence)
            fusion.integrate(keyframe.rgb, depth, confidence, part.camera.matrix, keyframe.world_from_camera)
        mesh = drop_small_components(fusion.extract(), config.fusion.min_component)[0].transformed(truth_from_run)
        errors = surface_errors(mesh, truth, 1.0, np.random.default_rng(0))
        figures[name] = {"f_score": errors.f_score, "precision": errors.precision, "recall": errors.recall}
        print(f"{name:14} {errors}", flush=True)
    write(arguments.json, {"run": arguments.run.name, "keyframes": len(part), "figures": figures})


if __name__ == "__main__":
    main()
