"""Stored working frames as odometry reads them."""

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import HaustraError
from pipeline.input.frames import read_image
from pipeline.matching.sift_cache import ReadFrame, SiftCache
from pipeline.run_folder.workspace import Workspace


def frame_reader(workspace: Workspace) -> ReadFrame:
    """Pictures and masks of the stored working frames, by their number."""
    return lambda index: (read_image(workspace.image_path(index)), _read_mask(workspace, index))


def frame_features(workspace: Workspace) -> SiftCache:
    """SIFT features of the stored working frames, each found once for all who share the cache."""
    return SiftCache(frame_reader(workspace), workspace.log / "features")


def _read_mask(workspace: Workspace, index: int) -> NDArray[np.uint8]:
    path = workspace.mask_path(index)
    mask = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if mask is None:
        raise HaustraError(f"{path} is missing or damaged; start the run anew with --overwrite")
    return mask
