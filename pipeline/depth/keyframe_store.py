"""Where the pictures and the completed depth of keyframes are kept, by the number of the frame in the source."""

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import HaustraError
from pipeline.depth.depth_io import read_confidence, read_depth, write_confidence, write_depth
from pipeline.input.frames import read_image
from pipeline.run_folder.workspace import Workspace


class KeyframeStore(Protocol):
    """rgb (H,W,3) uint8 and mask (H,W) uint8 as stored, with the lens's distortion; depth (H,W) float32 z-depth in
    scene units, 0 = none, and confidence (H,W) float32 in [0,1], both rectified."""

    def rgb(self, frame: int) -> NDArray[np.uint8]: ...

    def mask(self, frame: int) -> NDArray[np.uint8]: ...

    def depth(self, frame: int) -> NDArray[np.float32]: ...

    def confidence(self, frame: int) -> NDArray[np.float32]: ...


REFINED = "multiview"  # the stage after which a keyframe's depth is what the run folder's reader expects


@dataclass(frozen=True)
class DiskKeyframes:
    """Keyframes of a run folder. What is missing or damaged raises `HaustraError`.

    first: read the first depths, which the stage `multiview` has still to refine.
    """

    workspace: Workspace
    first: bool = False

    def rgb(self, frame: int) -> NDArray[np.uint8]:
        return read_image(self.workspace.image_path(frame))

    def mask(self, frame: int) -> NDArray[np.uint8]:
        path = self.workspace.mask_path(frame)
        mask = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if mask is None:
            raise HaustraError(f"{path} is missing or damaged; start the run anew with --overwrite")
        return mask

    def depth(self, frame: int) -> NDArray[np.float32]:
        return read_depth(self.workspace.depth_path(frame, self.first))

    def confidence(self, frame: int) -> NDArray[np.float32]:
        return read_confidence(self.workspace.confidence_path(frame, self.first))

    def has_depth(self, frame: int) -> bool:
        """Whether a keyframe's depth is whole on disk."""
        paths = self.workspace.depth_path(frame, self.first), self.workspace.confidence_path(frame, self.first)
        return all(path.exists() for path in paths)

    def write_depth(self, frame: int, depth: NDArray[np.float32], confidence: NDArray[np.float32]) -> None:
        """Depth (H,W) in scene units, 0 = none, and confidence (H,W) of a keyframe, both rectified."""
        for path in (self.workspace.depth_path(frame, self.first), self.workspace.confidence_path(frame, self.first)):
            path.parent.mkdir(exist_ok=True)
        write_confidence(self.workspace.confidence_path(frame, self.first), confidence)
        # Last, since its presence says that the keyframe is done.
        write_depth(self.workspace.depth_path(frame, self.first), depth)


def depth_on_disk(workspace: Workspace) -> DiskKeyframes:
    """The keyframes with the latest depth that is whole: first depths while those are still being refined."""
    return DiskKeyframes(workspace, workspace.first_depth.is_dir() and not workspace.is_done(REFINED))
