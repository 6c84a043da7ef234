"""The front ends by name. A new one is a file with a `FrontEnd` and a row here (docs/extending.md)."""

from haustra.core.errors import HaustraError
from pipeline.config import Config
from pipeline.frontend.base import FrontEnd
from pipeline.frontend.colmap.front_end import ColmapFrontEnd
from pipeline.frontend.odometry.front_end import OdometryFrontEnd

AUTO = "auto"
FIRST, SECOND = "odometry", "sfm"  # of `auto`

FRONT_ENDS: dict[str, FrontEnd] = {
    "odometry": OdometryFrontEnd(),
    "sfm": ColmapFrontEnd(),
}


def check_front_end(config: Config) -> None:
    """Refuse an unknown front end, and settings that the chosen one cannot work with."""
    if config.front_end == AUTO:
        return
    if config.front_end not in FRONT_ENDS:
        known = ", ".join((AUTO, *FRONT_ENDS))
        raise HaustraError(f"there is no front end '{config.front_end}'; known: {known}")
    FRONT_ENDS[config.front_end].check(config)
