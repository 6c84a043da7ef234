"""Keyframes of a run's first submap as other programs take them: pinhole picture, mask, pose, depth; and its points."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import HaustraError
from pipeline.finished_run import Run
from pipeline.mapping.submap import Submap, refined_camera


@dataclass(frozen=True)
class View:
    """number: of the frame in the source. rgb (H,W,3); mask (H,W), 255 where the picture is to be used; depth (H,W), 0
    = none; world_from_camera (4,4), OpenCV's axes. Lengths are in the run's unit."""

    number: int
    rgb: NDArray[np.uint8]
    mask: NDArray[np.uint8]
    depth: NDArray[np.float32]
    world_from_camera: NDArray[np.float64]


def views(run: Run) -> Iterator[View]:
    """One by one, since a long film's pictures do not fit the memory."""
    rectifier = run.completed_submaps[0].rectifier
    for keyframe in run.keyframes():
        mask = cv2.imread(str(run.workspace.mask_path(keyframe.frame)), cv2.IMREAD_GRAYSCALE)
        if mask is None:
            raise HaustraError(f"the run {run.folder} has lost its masks; make it anew with --overwrite")
        shown = np.where(rectifier.mask(mask) > 127, 255, 0).astype(np.uint8)
        yield View(keyframe.frame, keyframe.rgb, shown, keyframe.depth, keyframe.world_from_camera)


def pinhole_submap(run: Run) -> Submap:
    """The keyframes of the first submap and the points that two of them see, in the run's unit; pixels are those of the
    keyframes' pinhole pictures."""
    completed = run.completed_submaps[0]
    submap = completed.submap.scaled(run.surfaces[0].scale.factor)
    others = set(submap.frames.tolist()) - set(submap.frames[completed.rows].tolist())
    kept = submap.without_frames(others)
    lens, pinhole = refined_camera(run.frames.camera, completed.submap), completed.camera
    plane, known = lens.unproject(kept.pixels)
    pixels = plane * np.array(pinhole.focal) + np.array(pinhole.centre)
    seen = known & (pixels >= 0).all(axis=1) & (pixels < [pinhole.width, pinhole.height]).all(axis=1)
    often = np.bincount(kept.observations[seen, 1], minlength=len(kept.points)) >= 2
    seen &= often[kept.observations[:, 1]]
    observations = kept.observations[seen].copy()
    observations[:, 1] = (np.cumsum(often) - 1)[observations[:, 1]]
    return replace(
        kept,
        points=kept.points[often],
        error_px=kept.error_px[often],
        observations=observations,
        pixels=pixels[seen],
        camera_params=pinhole.params,
        camera_sigma=(),
        klt=None,
        depth_error=None,
    )


def point_colours(submap: Submap, pictures: dict[int, NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """(P,3) RGB of each point, from the picture of the first frame that saw it; pictures: by frame number."""
    colours = np.full((len(submap.points), 3), 128, np.uint8)
    for row in range(len(submap.frames) - 1, -1, -1):
        mine = submap.observations[:, 0] == row
        rgb = pictures[int(submap.frames[row])]
        x, y = np.floor(submap.pixels[mine]).astype(int).T
        colours[submap.observations[mine, 1]] = rgb[y, x]
    return colours


def empty_folder(target: Path) -> Path:
    """The folder to write to, made. HaustraError where there is something in it already."""
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise HaustraError(f"{target} is there already; give a new or empty folder")
    target.mkdir(parents=True, exist_ok=True)
    return target
