"""The front ends by name. A new one is a file with a `FrontEnd` and a row here (docs/extending.md)."""

from haustra.core.errors import HaustraError
from pipeline.config import FrontEndSettings
from pipeline.frontend.base import FrontEnd
from pipeline.frontend.colmap.front_end import ColmapFrontEnd
from pipeline.frontend.known_poses.front_end import KnownPosesFrontEnd
from pipeline.frontend.odometry.front_end import OdometryFrontEnd

AUTO = "auto"
POSES = "poses"  # what poses that are given are read by
FIRST, SECOND = "odometry", "sfm"  # of `auto`

FRONT_ENDS: dict[str, FrontEnd] = {
    "odometry": OdometryFrontEnd(),
    "sfm": ColmapFrontEnd(),
    POSES: KnownPosesFrontEnd(),
}


def check_front_end(name: str, settings: FrontEndSettings) -> None:
    """Refuse an unknown front end, and settings that the chosen one cannot work with."""
    if settings.poses.file is not None and name not in (AUTO, POSES):
        raise HaustraError(f"--poses takes the place of the front end {name}; leave one of them out")
    name = chosen(name, settings)
    if name == AUTO:
        return
    if name not in FRONT_ENDS:
        raise HaustraError(f"there is no front end '{name}'; known: {', '.join((AUTO, *FRONT_ENDS))}")
    FRONT_ENDS[name].check(settings)


def chosen(name: str, settings: FrontEndSettings) -> str:
    """The front end that is run: `poses` where there are poses."""
    return POSES if settings.poses.file is not None else name
