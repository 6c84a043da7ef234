"""The scale of a submap by a sensor's depth, and whether the two agree: unit, calibration, time.

Each observation of a triangulated point has a depth in the map and, where the sensor saw something, one in millimetres.
Their ratio is the scale; its median over all is exact to a few thousandths, whatever the noise. What is left of the
ratios after each frame's own median says how well the two agree.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import HaustraError
from haustra.core.text import counted
from pipeline.depth.sparse_depth import reliable_points
from pipeline.input.sensor.along_ray import FEWEST, doubt_of_axis, within_frames
from pipeline.input.sensor.sensor_depth import SensorDepth
from pipeline.input.sensor.usual_distances import check_unit, doubt_of_unit
from pipeline.mapping.submap import Submap

Array = NDArray[np.float64]
MOST_FRAMES = 120  # spread over the submap
SHIFTS = (-5, -4, -3, -2, -1, 1, 2, 3, 4, 5)  # frames by which the sensor may be off
BETTER = 0.9  # a shift must lower the disagreement to this part of it
# Frames from their own to where the parabola through the squared disagreements is lowest. A map that late depth
# adjusted has taken on a third to two thirds of the shift. Chosen on withdrawal_b, flexure_b, flexure_c, insertion_b
# and low_texture_b of coverage_films.yaml: right depth has -0.6 to 0.2, depth three frames off 1.0 to 1.9.
LATE = 0.8
NEAR = 1.05  # times the disagreement of its own frame: what one on the parabola's side has at most
LEAST_RISE = 0.1  # of the parabola within five frames, share of its lowest: less, and the camera stood still
MOST_DISAGREEMENT = 0.12  # median absolute log ratio; 3 % of noise and the map's own error leave 0.03 to 0.05
SAME_UNIT = 0.01  # between the median and the unit of a map that was adjusted in mm; they differ by 0.1 to 0.3 %


@dataclass(frozen=True)
class SensorScale:
    """mm_per_unit; count: ratios that it is the median of; disagreement: median absolute log ratio within the frames;
    drift: standard deviation of the frames' own log scales; doubt: of the sensor's unit or shape, empty without a
    reason;
    clock_doubt: of its clock; median: what the ratios said, where the map was adjusted in mm and its own unit takes
    their place."""

    mm_per_unit: float
    count: int
    disagreement: float
    drift: float
    doubt: str = ""
    clock_doubt: str = ""
    median: float | None = None

    def __str__(self) -> str:
        adjusted = "" if self.median is None else f"as the map was adjusted by it; {self.median:.4g} by the "
        return (
            f"depth of the sensor: {self.mm_per_unit:.4g} mm per scene unit, {adjusted}median of {self.count} points; "
            f"within the frames the two differ by {100 * self.disagreement:.1f} % in the median, from frame to frame "
            f"the scale by {100 * self.drift:.1f} %"
        )

    def in_unit_of(self, units: list[float]) -> "SensorScale":
        """The scale of a map that was adjusted in mm, whose unit is then one of these, mm: the adjustment weighs each
        depth by its error and its point's rays, the median does not. Of another map, the median."""
        near = min(units, key=lambda unit: abs(unit / self.mm_per_unit - 1), default=self.mm_per_unit)
        if near == self.mm_per_unit or abs(near / self.mm_per_unit - 1) >= SAME_UNIT:
            return self
        return replace(self, mm_per_unit=near, median=self.mm_per_unit)


def sensor_scale(submap: Submap, sensor: SensorDepth) -> SensorScale | None:
    """Scale of a submap in scene units; None where too little of it has depth. HaustraError, one sentence, where the
    sensor's unit, lens or clock cannot be right."""
    log_ratio, row, slant = _log_ratios(submap, sensor, 0)
    if len(log_ratio) < FEWEST:
        return None
    disagreement, medians = within_frames(log_ratio, row)
    late = "" if sensor.stereo else _check_time(submap, sensor, disagreement)  # a pair's depth is of its own time
    if disagreement > MOST_DISAGREEMENT:
        raise HaustraError(
            f"the sensor's depth and the pictures' geometry differ by {100 * disagreement:.0f} % in the median within "
            "a frame: is the sensor registered to this camera, and the camera's calibration right? --depth none leaves "
            "it out"
        )
    scale = float(np.exp(np.median(log_ratio)))
    depths = submap.depths()
    median_mm = scale * float(np.median(depths[depths > 0]))
    check_unit(median_mm, sensor.stereo)
    doubts = [doubt_of_unit(median_mm, sensor.stereo)]
    if not sensor.stereo:
        doubts += [sensor.doubt_of_shape, doubt_of_axis(log_ratio, slant, row)]
    doubt = "; ".join(filter(None, doubts))
    return SensorScale(scale, len(log_ratio), disagreement, float(np.std(medians)), doubt, late)


def check_frames(sensor: SensorDepth | None, frames: NDArray[np.int64]) -> None:
    """HaustraError where none of a sensor's depth images is of one of the frames that are used."""
    if sensor is None or sensor.stereo or not sensor.files or not sensor.files.keys().isdisjoint(frames.tolist()):
        return
    of_images = f"{min(sensor.files)} to {max(sensor.files)}"
    raise HaustraError(
        f"none of the {len(sensor.files)} depth images is of one of the {len(frames)} frames that are used: by the "
        f"numbers in their names they are of frames {of_images}, and frames {frames.min()} to {frames.max()} are used; "
        "give those of this film, or leave them out by --depth none"
    )


def _check_time(submap: Submap, sensor: SensorDepth, disagreement: float) -> str:
    """Refuse depth that fits other frames than its own clearly better; a doubt of depth that fits them a little better,
    empty without a reason."""
    found = {0: disagreement}
    for shift in SHIFTS:
        log_ratio, row, _ = _log_ratios(submap, sensor, shift)
        if len(log_ratio) >= FEWEST:
            found[shift] = within_frames(log_ratio, row)[0]
    best = min(found, key=lambda shift: (found[shift], abs(shift)))
    if best != 0 and found[best] < BETTER * disagreement:
        when = f"{counted(abs(best), 'frame')} {'late' if best > 0 else 'early'}"
        advice = (
            f"{'take' if best > 0 else 'add'} {abs(best)} {'from' if best > 0 else 'to'} the number of each depth image"
        )
        raise HaustraError(
            f"the sensor's depth is {when}: taken so, it differs from the geometry by {100 * found[best]:.1f} % "
            f"instead of {100 * disagreement:.1f} %; {advice}"
        )
    lowest = float(np.clip(_lowest_at(found), min(SHIFTS), max(SHIFTS)))
    side = min(found[shift] for shift in found if shift * lowest > 0) if lowest else np.inf
    if abs(lowest) < LATE or side > NEAR * disagreement:  # uneven motion bends the parabola, too
        return ""
    when, remedy = ("late", "take that from") if lowest > 0 else ("early", "add that to")
    return (
        "do not trust depth and lengths: the sensor's depth fits the geometry best as if it were "
        f"{counted(round(abs(lowest)), 'frame')} or more {when}; {remedy} the number of each depth image and run again "
        "(or check that the sensor adds no constant length)"
    )


def _lowest_at(disagreement: dict[int, float]) -> float:
    """Shift at which the parabola through the squared disagreements of shifts is lowest; 0 where it is flat."""
    shifts, square = np.array(list(disagreement)), np.square(list(disagreement.values()))
    if len(shifts) <= len(SHIFTS):
        return 0.0
    curvature, slope, at_zero = np.polyfit(shifts, square, 2)
    lowest = -slope / (2 * curvature) if curvature > 0 else 0.0
    rise = curvature * max(SHIFTS) ** 2
    return float(lowest) if rise > LEAST_RISE * (at_zero - curvature * lowest**2) else 0.0


def _log_ratios(submap: Submap, sensor: SensorDepth, shift: int) -> tuple[Array, NDArray[np.int64], Array]:
    """(K,) log of mm over scene units, (K,) rows of the frames, and (K,) log of the distance along the ray over the
    depth along the axis; shift: the sensor's frames are so many later."""
    good, _ = reliable_points(submap, submap.triangulation_angles(), submap.camera_params[0])
    rows = np.unique(np.linspace(0, len(submap.frames) - 1, min(MOST_FRAMES, len(submap.frames))).round().astype(int))
    depths, ratios, found, slants = submap.depths(), [np.zeros(0)], [np.zeros(0, np.int64)], [np.zeros(0)]
    order, starts = submap.by_frame()
    for row in rows.tolist():
        mine = order[starts[row] : starts[row + 1]]
        mine = mine[good[submap.observations[mine, 1]] & (depths[mine] > 0)]
        measured = sensor.at(int(submap.frames[row]) + shift, submap.pixels[mine])
        known = measured > 0
        ratios.append(np.log(measured[known] / depths[mine][known]))
        found.append(np.full(int(known.sum()), row))
        away = submap.points[submap.observations[mine[known], 1]] - submap.centres[row]
        slants.append(np.log(np.linalg.norm(away, axis=1) / depths[mine][known]))
    return np.concatenate(ratios), np.concatenate(found), np.concatenate(slants)
