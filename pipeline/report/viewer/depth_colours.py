"""The colours of a run's depth pictures: one range a submap, in the run's unit, by the report's colours."""

from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.depth.depth_io import DEPTH_STEP, read_depth
from pipeline.report.page.keyframe_gallery import DEPTH_MAP, RANGE_SAMPLES, colour_range, painted
from pipeline.run_folder.earlier_run import RECORD_NAME
from pipeline.run_folder.workspace import Workspace, open_workspace
from pipeline.surface.scale import unit_label


@dataclass(frozen=True)
class DepthScale:
    """low, high: depths at the ends of the colours, in `unit`; factors: of each of `keyframes`, from the depth that is
    stored to that unit."""

    low: float
    high: float
    unit: str
    keyframes: tuple[int, ...]
    factors: tuple[float, ...]

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


def depth_scales(folder: Path) -> tuple[DepthScale, ...]:
    """The scale of each submap that has keyframes."""
    return _scales(folder, (folder / RECORD_NAME).stat().st_mtime_ns)


@lru_cache(maxsize=64)
def _scales(folder: Path, _: int) -> tuple[DepthScale, ...]:
    workspace = open_workspace(folder)
    return tuple(_of_submap(workspace, record) for record in workspace.record.get("submaps", []) if record["keyframes"])


def _of_submap(workspace: Workspace, record: dict[str, Any]) -> DepthScale:
    """By the keyframes whose depth is still there."""
    keyframes, factor = tuple(record["keyframes"]), record["depth_png_step"] / DEPTH_STEP
    factors = tuple(factor * scale for scale in record.get("depth_scale") or [1.0] * len(keyframes))
    step = max(1, len(keyframes) // RANGE_SAMPLES)
    sampled = [(workspace.depth_path(k), f) for k, f in list(zip(keyframes, factors, strict=True))[::step]]
    depths = (read_depth(path) * np.float32(f) for path, f in sampled if path.is_file())
    low, high = colour_range(depths, 1.0)
    return DepthScale(low, high, unit_label(record["unit"]), keyframes, factors)


def painted_depth(folder: Path, keyframe: int) -> NDArray[np.uint8]:
    """BGR (H,W,3); by its own range where no submap has the keyframe."""
    depth = read_depth(Workspace(folder).depth_path(keyframe))
    for scale in depth_scales(folder):
        if keyframe in scale.keyframes:
            factor = scale.factors[scale.keyframes.index(keyframe)]
            return painted(depth * np.float32(factor), (scale.low, scale.high), DEPTH_MAP)
    return painted(depth, colour_range([depth], 1.0), DEPTH_MAP)
