"""Stage 3: dense depth and confidence of every keyframe, from its image and its sparse depth."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from completion.inference.completer import DepthCompleter
from haustra.core.camera import Camera
from haustra.core.progress import Progress
from pipeline.config import Config
from pipeline.depth.depth_io import read_confidence, read_depth, write_confidence, write_depth
from pipeline.depth.keyframe_selection import choose_keyframes
from pipeline.depth.rectification import Rectifier, make_rectifier
from pipeline.depth.sparse_depth import SparseDepthMaker
from pipeline.frontend.select import structure_camera
from pipeline.input.frames import Frames, read_image
from pipeline.mapping.submap import Submap
from pipeline.run_folder.workspace import Workspace, write_json


@dataclass(frozen=True)
class Keyframe:
    """A completed frame as fusion takes it: pinhole image, z-depth in scene units (0 = none), confidence, pose."""

    index: int
    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]
    confidence: NDArray[np.float32]
    world_from_camera: NDArray[np.float64]


@dataclass(frozen=True)
class DenseSubmap:
    """The keyframes of one submap, read from disk one at a time."""

    submap: Submap
    rectifier: Rectifier
    rows: NDArray[np.int64]  # of the keyframes in the submap
    workspace: Workspace
    depth_scale: NDArray[np.float64] | None = None  # (N,) for every frame of the submap: factor on its stored depth

    @property
    def camera(self) -> Camera:
        return self.rectifier.camera

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[Keyframe]:
        for row in self.rows:
            yield self.keyframe(int(row))

    def keyframe(self, row: int) -> Keyframe:
        index = int(self.submap.frames[row])
        rgb = self.rectifier.image(read_image(self.workspace.image_path(index)))
        return Keyframe(index, rgb, *self.depth(row))

    def depth(self, row: int) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float64]]:
        """Depth, confidence and pose of a keyframe, without its image."""
        index = int(self.submap.frames[row])
        depth = read_depth(self.workspace.depth_path(index))
        if self.depth_scale is not None:
            depth *= np.float32(self.depth_scale[row])
        return depth, read_confidence(self.workspace.confidence_path(index)), self.submap.world_from_camera[row]


def complete_depth(
    frames: Frames, submaps: list[Submap], config: Config, workspace: Workspace, progress: Progress
) -> list[DenseSubmap]:
    """Complete the keyframes of every submap; those already on disk are kept."""
    if workspace.is_done("depth"):
        return planned_keyframes(frames, submaps, workspace)
    dense = [_plan(frames, submap, config, workspace) for submap in submaps]
    workspace.depth.mkdir(exist_ok=True)
    workspace.confidence.mkdir(exist_ok=True)
    for number, part in enumerate(dense):
        write_json(camera_path(workspace, number), part.camera.to_dict())
    completer = DepthCompleter.load(config.model, config.device, iterations=config.depth.iterations)
    total = sum(len(part) for part in dense)
    done, kept = 0, []
    with progress.bar("depth completion", total) as advance:
        for part in dense:
            maker = SparseDepthMaker(part.submap, part.camera, config.sparse)
            content = part.rectifier.mask(frames.content)
            completed = []
            for row in part.rows:
                if _complete(part, int(row), maker, content, completer, config):
                    completed.append(int(row))
                done += 1
                advance(done)
            kept.append(completed)
    workspace.finish("depth", keyframe_rows=kept, kept_share=[round(p.rectifier.kept_share, 4) for p in dense])
    skipped = total - sum(len(rows) for rows in kept)
    progress.say(f"{total - skipped} keyframes completed" + (f", {skipped} had too few points" if skipped else ""))
    return planned_keyframes(frames, submaps, workspace)


def camera_path(workspace: Workspace, number: int) -> Path:
    """`camera.json`, and `camera_1.json` and on for further submaps, whose lens may have been refined otherwise."""
    return workspace.camera if number == 0 else workspace.root / f"camera_{number}.json"


def planned_keyframes(frames: Frames, submaps: list[Submap], workspace: Workspace) -> list[DenseSubmap]:
    """The completed keyframes of a finished depth stage."""
    dense = [_plan(frames, submap, workspace.config, workspace) for submap in submaps]
    rows = workspace.result("depth")["keyframe_rows"]
    return [replace(part, rows=np.array(r, dtype=np.int64)) for part, r in zip(dense, rows, strict=True)]


def _plan(frames: Frames, submap: Submap, config: Config, workspace: Workspace) -> DenseSubmap:
    camera = structure_camera(frames.camera, submap)
    rows = choose_keyframes(submap, camera.width, config.depth.keyframe_motion)
    return DenseSubmap(submap, make_rectifier(camera, config.depth.max_fov_deg), rows, workspace)


def _complete(
    part: DenseSubmap,
    row: int,
    maker: SparseDepthMaker,
    content: NDArray[np.uint8],
    completer: DepthCompleter,
    config: Config,
) -> bool:
    """Complete one keyframe and write it; False if it has too few points."""
    index = int(part.submap.frames[row])
    sparse = maker.sparse_depth(row)
    if len(sparse.depth) < config.depth.min_points:
        return False
    workspace = part.workspace
    if workspace.depth_path(index).exists() and workspace.confidence_path(index).exists():
        return True
    rgb = part.rectifier.image(read_image(workspace.image_path(index)))
    depth, confidence = completer(rgb, *sparse.maps(*content.shape))
    inside = cv2.erode(content, np.ones((3, 3), np.uint8)) > 0 if not content.all() else content > 0
    write_confidence(workspace.confidence_path(index), np.where(inside, confidence, 0))
    # Last, since its presence says that the keyframe is done.
    write_depth(workspace.depth_path(index), np.where(inside, depth, 0))
    return True
