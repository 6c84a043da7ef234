"""What a front end is: working frames in, submaps of poses and sparse points out."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from haustra.core.progress import Progress
from pipeline.config import FrontEndSettings
from pipeline.input.frames import Frames
from pipeline.mapping.submap import Submap
from pipeline.matching.sift_cache import SiftCache
from pipeline.run_folder.workspace import Workspace

COLMAP_WORKER = "pipeline.frontend.colmap.worker"  # run in a process of its own
MAX_FOCAL_SIGMA = 0.03  # of the focal length; depth errs by about as much as the focal length


def is_determined(focal: float, sigma: tuple[float, ...]) -> bool:
    """Whether a map determines its lens: by the sigmas of the refined parameters, focal length first; none or NaN:
    it does not."""
    return len(sigma) > 0 and sigma[0] <= MAX_FOCAL_SIGMA * focal


@dataclass(frozen=True)
class FoundSubmap:
    """A submap in any unit. model: folder of the COLMAP model that it was read from; None: still to be written."""

    submap: Submap
    model: Path | None = None


@dataclass(frozen=True)
class FrontEndResult:
    """found: submaps of each mapper that was run, by its name, in the order in which they were run. stats: figures of
    the front end for `run.yaml`, such as frames_per_second. warnings: sentences for a person."""

    found: dict[str, list[FoundSubmap]]
    stats: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


class FrontEnd(Protocol):
    """A way to find the structure of a video.

    closes_loops: whether it matches frames that are far apart in time itself; else loop closing follows the depth.
    """

    closes_loops: bool

    def check(self, settings: FrontEndSettings) -> None:
        """Raise `HaustraError` for settings that it cannot work with, before any work is done."""

    def run(
        self, frames: Frames, features: SiftCache, settings: FrontEndSettings, workspace: Workspace, progress: Progress
    ) -> FrontEndResult:
        """Structure of the stored working frames. Files of its own go to `workspace.log`.

        features: of the working frames; what is found here need not be found again by the stages that follow."""


def disjoint(submaps: Iterable[Submap]) -> list[Submap]:
    """Each frame to the first submap that has it: a mapper may pose one frame in several models, but a frame has one
    depth map."""
    claimed: set[int] = set()
    parts = []
    for submap in submaps:
        parts.append(submap.without_frames(claimed))
        claimed |= set(submap.frames.tolist())
    return parts
