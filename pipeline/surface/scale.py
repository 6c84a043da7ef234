"""The scale of a submap: which of its sources counts, and two of them, a scale file and the lumen's median diameter.

Sources in the order in which they count: a scale file, the lumen's median diameter, a sensor or second eye, the unit
of given poses (the last two: `given_scales`). One that gives clearly other lengths than the one that counts is a doubt.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from haustra.core.errors import HaustraError
from haustra.core.text import read_text
from haustra.core.unique_yaml import load_unique
from pipeline.mapping.submap import Submap
from reconstruction.coverage.lumen_diameter import measure_lumen
from reconstruction.mesh.surface_mesh import SurfaceMesh


def unit_label(unit: str) -> str:
    """An output unit as a person reads it."""
    return "mm" if unit == "mm" else "scene units"


@dataclass(frozen=True)
class ScaleSource:
    """What sets millimetres, the first that there is: a scale file, the lumen's median diameter, or what a sensor or
    the poses say of each submap (`given`, by the submaps' numbers)."""

    lumen_mm: float | None = None
    file: Path | None = None
    given: "tuple[Scale | None, ...]" = ()

    def of_submap(self, number: int) -> "ScaleSource":
        """What speaks of one submap: a file does of the first alone, since the others have units of their own."""
        return ScaleSource(self.lumen_mm, self.file if number == 0 else None, self.given[number : number + 1])


@dataclass(frozen=True)
class Scale:
    """factor: output units per scene unit; unit: 'mm' or 'scene'; origin: one sentence; doubt: why the millimetres are
    not to be trusted, empty without a reason; clock_doubt: why a sensor's depth, which shapes the map too where it is
    used, may be of other frames, whoever gives the millimetres."""

    factor: float
    unit: str
    origin: str
    doubt: str = ""
    clock_doubt: str = ""

    def __str__(self) -> str:
        return "; ".join(filter(None, [self.origin, self.doubt, self.clock_doubt]))

    def with_doubt(self, why: str) -> "Scale":
        """The same with one more reason for doubt."""
        return replace(self, doubt="; ".join(filter(None, [self.doubt, why])))


MOST_APART = 1.1  # factor between two sources of one scale that both may be right
SCENE = Scale(1.0, "scene", "no scale given: 1 scene unit is the median depth of the triangulated points")


def checked_against(scale: Scale, others: Iterable[Scale | None]) -> Scale:
    """The scale, with a doubt where another source in millimetres gives clearly other lengths."""
    for other in others:
        if other is None or scale.unit != "mm" or other.unit != "mm":
            continue
        factor = other.factor / scale.factor
        if abs(math.log(factor)) > math.log(MOST_APART):
            apart = f"one of two is wrong, all lengths would be {factor:.3g} times these by the {other.origin}"
            scale = replace(
                scale, doubt=f"{scale.doubt}; {apart}" if scale.doubt else f"do not trust the millimetres: {apart}"
            )
    return scale


def find_scale(source: ScaleSource, submap: Submap, mesh: SurfaceMesh) -> Scale:
    """Scale of a submap whose mesh and poses are in scene units."""
    clock = next((given.clock_doubt for given in source.given if given is not None), "")
    return replace(_chosen_scale(source, submap, mesh), clock_doubt=clock)


def _chosen_scale(source: ScaleSource, submap: Submap, mesh: SurfaceMesh) -> Scale:
    given = next((scale for scale in source.given if scale is not None), SCENE)
    if source.file is not None:
        return checked_against(_scale_from_file(source.file, submap, given), source.given)
    if source.lumen_mm is None:
        return given
    # One median depth ahead: in a tube that is where the picture's middle ground lies.
    path = submap.world_from_camera
    width = measure_lumen(mesh.vertices, mesh.faces, path, reach=1.0) if len(mesh.faces) else None
    if width is None:
        none = "the surface nowhere surrounds the camera's path, so --lumen-mm has no meaning here"
        return replace(given, origin=none if given.origin == SCENE.origin else f"{given.origin}; {none}")
    origin = (
        f"median lumen diameter set to {source.lumen_mm:g} mm, measured at {width.stations} of {width.tried} stations"
    )
    return checked_against(Scale(source.lumen_mm / width.diameter, "mm", origin), source.given)


def check_scale_file(path: Path) -> dict[str, float]:
    """The contents of a scale file: `mm_per_unit`, or `frame_a`, `frame_b` and `distance_mm` between the cameras."""
    text = read_text(path)
    try:
        values = load_unique(text)
        if any(isinstance(value, bool) for value in values.values()):
            raise ValueError("a truth value is no number")
        numbers = {str(name): float(value) for name, value in values.items()}
    except (yaml.YAMLError, AttributeError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise HaustraError(
            f"cannot read the scale file {path}: it must name numbers, as mm_per_unit: 12.5 does"
        ) from error
    lengths = [numbers.get(name, 1.0) for name in ("mm_per_unit", "distance_mm")]
    known = set(numbers) in ({"mm_per_unit"}, {"frame_a", "frame_b", "distance_mm"})
    whole = all(number.is_integer() for name, number in numbers.items() if name.startswith("frame_"))
    if not known or not np.isfinite(list(numbers.values())).all() or min(lengths) <= 0 or not whole:
        raise HaustraError(
            f"the scale file {path} must give mm_per_unit, or frame_a, frame_b and distance_mm, as positive numbers; "
            "frames are whole ones"
        )
    return numbers


def check_scale_frames(path: Path | None, frames: NDArray[np.int64]) -> None:
    """HaustraError where a scale file names frames that are none of those that are used, by their numbers (N,), or one
    frame twice: before the work, for hours of it may follow."""
    numbers = {} if path is None else check_scale_file(path)
    named = [int(numbers[name]) for name in ("frame_a", "frame_b") if name in numbers]
    for frame in named:
        if frame not in frames:
            raise HaustraError(
                f"frame {frame} of the scale file {path} is none of the {len(frames)} frames that are used, from "
                f"{frames.min()} to {frames.max()}; correct it, and go on with --resume"
            )
    if len(named) == 2 and named[0] == named[1]:
        raise HaustraError(f"the scale file {path} names frame {named[0]} twice; it needs two")


def _unscaled(without_file: Scale, why: str) -> Scale:
    """The scale without the file, and why; a run of hours is not ended for a scale, which can be given again."""
    return without_file.with_doubt(
        f"{why}, so that the file gives no scale; correct it, and give the same command with --resume"
    )


def _scale_from_file(path: Path, submap: Submap, without_file: Scale) -> Scale:
    """Scale by a file, of frames by their distance; `mm_per_unit` is per unit of the same run without a file and
    --lumen-mm, which is scaled by `without_file`. Frames that the submap lacks leave that scale, with a doubt."""
    numbers = check_scale_file(path)
    if "mm_per_unit" in numbers:
        times, unit = numbers["mm_per_unit"], "mm that there are without it" if without_file.unit == "mm" else "unit"
        origin = f"scale file {path.name}: {times:g} mm per {unit}"
        return Scale(times * without_file.factor, "mm", origin, without_file.doubt)
    centres = []
    for name in ("frame_a", "frame_b"):
        row = np.flatnonzero(submap.frames == int(numbers[name]))
        if len(row) == 0:
            first, last = submap.frames.min(), submap.frames.max()
            of = f"frame {int(numbers[name])} of the scale file {path.name} has no pose in the submap of frames {first}"
            return _unscaled(without_file, f"{of} to {last}")
        centres.append(submap.centres[row[0]])
    distance = float(np.linalg.norm(centres[1] - centres[0]))
    if distance == 0:
        return _unscaled(without_file, f"the two frames of the scale file {path.name} have the same place")
    return Scale(numbers["distance_mm"] / distance, "mm", f"scale file {path.name}: distance of two frames")
