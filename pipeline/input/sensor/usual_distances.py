"""From how far an endoscope looks at the wall: what tells a wrong unit of millimetres."""

from haustra.core.errors import HaustraError

UNIT_OPTION = "depth's unit (--depth-unit-mm)"
NEAREST_MM, FARTHEST_MM = 4.0, 250.0  # median depth of an endoscope's view
# Where most views' are. It is a factor of ten: a view between them whose unit is off by ten is always outside.
USUAL_MM = 8.0, 80.0


def check_unit(median_mm: float, stereo: bool) -> None:
    """HaustraError for a median depth, mm, that is none of an endoscope's view."""
    check_view(median_mm, *("second eye", "baseline in the stereo calibration") if stereo else ("sensor", UNIT_OPTION))


def check_view(median_mm: float, who: str, what: str) -> None:
    """The same of any source `who` of millimetres, whose `what` is to be checked."""
    if not NEAREST_MM <= median_mm <= FARTHEST_MM:
        raise HaustraError(
            f"by the {who} the wall is {median_mm:.3g} mm away in the median, and endoscopes look from "
            f"{NEAREST_MM:g} to {FARTHEST_MM:g} mm: check the {what}"
        )


def doubt_of_unit(median_mm: float, stereo: bool) -> str:
    """A sentence where a sensor's median depth, mm, is one that few endoscopes' views have; empty for a usual one, and
    for a second eye, whose unit nobody types."""
    return "" if stereo else doubt_of_view(median_mm, "sensor", UNIT_OPTION)


def doubt_of_view(median_mm: float, who: str, what: str) -> str:
    """The same of any source `who` of millimetres, whose `what` is to be checked."""
    near, far = USUAL_MM
    if near <= median_mm <= far:
        return ""
    found = f"by the {who} the wall is {median_mm:.3g} mm away in the median"
    usual = f"most colonoscopes look from {near:g} to {far:g} mm"
    return f"do not trust the millimetres before you have checked the {what}: {found}, and {usual}"
