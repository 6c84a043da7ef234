"""A submap with the completed depth of its keyframes, read from where they are kept one at a time."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera
from pipeline.depth.keyframe_store import KeyframeStore
from pipeline.depth.rectification import Rectifier
from pipeline.mapping.submap import Submap


@dataclass(frozen=True)
class CompletedKeyframe:
    """A completed frame as fusion takes it, rectified to a pinhole; lengths in scene units."""

    index: int  # number of the frame in the source
    rgb: NDArray[np.uint8]  # (H,W,3)
    depth: NDArray[np.float32]  # (H,W) z-depth, 0 = none
    confidence: NDArray[np.float32]  # (H,W) in [0,1]
    world_from_camera: NDArray[np.float64]  # (4,4)


@dataclass(frozen=True)
class CompletedSubmap:
    """A submap, and which of its frames are keyframes with completed depth; these are read from disk one at a time.

    Keyframe number n of N is frame row `rows[n]` of `submap`; the methods take the frame row.
    """

    submap: Submap
    rectifier: Rectifier
    rows: NDArray[np.int64]  # (N,) of the keyframes among the submap's frames
    store: KeyframeStore
    depth_scale: NDArray[np.float64] | None = None  # of each frame of the submap: factor on its stored depth

    @property
    def camera(self) -> Camera:
        """The pinhole of the rectified pictures and of the depth."""
        return self.rectifier.camera

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[CompletedKeyframe]:
        for row in self.rows:
            yield self.keyframe(int(row))

    def keyframe(self, row: int) -> CompletedKeyframe:
        return CompletedKeyframe(int(self.submap.frames[row]), self.rgb(row), *self.depth(row))

    def rgb(self, row: int) -> NDArray[np.uint8]:
        """The rectified picture (H,W,3) of a frame."""
        return self.rectifier.image(self.store.rgb(int(self.submap.frames[row])))

    def mask(self, row: int) -> NDArray[np.uint8]:
        """The rectified mask (H,W) of a frame, nonzero where features may lie."""
        return self.rectifier.mask(self.store.mask(int(self.submap.frames[row])))

    def depth(self, row: int) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float64]]:
        """Depth (H,W), confidence (H,W) and world_from_camera (4,4) of a keyframe, without its image."""
        index = int(self.submap.frames[row])
        depth = self.store.depth(index)
        if self.depth_scale is not None:
            depth *= np.float32(self.depth_scale[row])
        return depth, self.store.confidence(index), self.submap.world_from_camera[row]
