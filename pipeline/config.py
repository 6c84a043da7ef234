"""Every setting of `reconstruct`, with its unit and the reason for its default.

Nothing here must be set to run. A YAML file given with `--config` overrides what it names; unknown keys are refused.
Lengths in the image are shares of the working width, so that they hold at any resolution.
"""

from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, PositiveInt, ValidationError, model_validator

from haustra.core.errors import HaustraError

FAST_KEYFRAME_MOTION = 0.05  # of `--fast`: see docs/lab/front_end.md


class Settings(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class FrameSettings(Settings):
    """Decoding and judging frames."""

    start_s: float = Field(0.0, ge=0, description="s; frames before it are left out")
    end_s: float | None = Field(None, description="s; frames from it on are left out")
    stride: int = Field(1, ge=1, description="use every n-th frame")
    long_side: int = Field(480, ge=96, description="px; SIFT's precision gains little beyond, its time doubles")
    min_brightness: float = Field(8.0, description="grey levels; a darker median frame is black")
    max_burnt: float = Field(0.6, description="share of pixels at 250 and more beyond which nothing is left to see")
    min_texture: float = Field(1.2, description="grey levels, robust spread of the Laplacian; red-out is below it")
    min_relative_sharpness: float = Field(0.3, description="of the running median; a third is motion blur")
    min_change: float = Field(0.35, description="grey levels between thumbnails; compression alone gives 0.2")

    @model_validator(mode="after")
    def _ends_after_it_starts(self) -> "FrameSettings":
        if self.end_s is not None and self.end_s <= self.start_s:
            raise ValueError("end_s must be after start_s")
        return self


class StructureSettings(Settings):
    """SIFT, matching and mapping by COLMAP."""

    peak_threshold: float = Field(0.002, description="a third of COLMAP's: mucosa has weak contrast")
    max_features: int = Field(2048, ge=100, description="per frame; more only lengthens matching")
    overlap: int = Field(8, ge=1, description="frames; each is matched with as many before it")
    loop_neighbours: int = Field(2, ge=0, description="look-alike frames beyond the overlap tried for each keyframe")
    loop_stride: int = Field(10, ge=1, description="frames between two that look for loops")
    threads: int = Field(2, ge=1, description="of feature extraction; matching and mapping take one, to be repeatable")
    min_registered: float = Field(0.8, description="share of frames below which a second mapper is asked")
    max_dark_near: float = Field(
        0.05, description="share of frames with brightness growing with distance that is tolerated"
    )


class OdometrySettings(Settings):
    """How the video is tracked."""

    keyframe_motion: float = Field(
        0.012, gt=0, le=0.2, description="share of the width that corners move by between keyframes"
    )
    chunks: int = Field(1, ge=1, description="overlapping parts that are tracked at once, each in its own process")
    ray: str | None = Field(None, description="address of a Ray cluster that tracks the chunks, or local")

    @model_validator(mode="after")
    def _has_chunks_for_ray(self) -> "OdometrySettings":
        if self.ray is not None and self.chunks == 1:
            raise ValueError("ray tracks chunks; say how many")
        return self


class SparseSettings(Settings):
    """From COLMAP's points to each frame's sparse depth."""

    max_reprojection_px: float = Field(1.5, gt=0, description="px at working size, mean over the track")
    min_track_length: int = Field(3, ge=2)
    min_angle_deg: float = Field(1.0, ge=0, description="deg; below it a pixel of error is a tenth of the depth")
    pixel_noise: float = Field(0.5, gt=0, description="px; SIFT's localisation error on mucosa")
    neighbours: int = Field(4, ge=0, description="frames on each side whose points are projected too")
    outlier_ratio: float = Field(0.25, gt=0, description="log-depth difference to the neighbours' median")


class DepthSettings(Settings):
    """Which frames are completed, and by what."""

    keyframe_motion: float = Field(0.02, gt=0, description="share of the width that shared points move by")
    min_points: int = Field(12, ge=1, description="fewer sparse points do not fix a frame's depth")
    iterations: PositiveInt | None = Field(
        None, description="of the network for each frame, at most as many as it was trained for; None: 2"
    )
    max_fov_deg: float = Field(120.0, description="deg; a pinhole image wider than this is mostly stretched border")

    @model_validator(mode="before")
    @classmethod
    def _reads_former_names(cls, values: Any) -> Any:
        """`looks`, as earlier releases wrote it into `run.yaml`, is `iterations`."""
        if not isinstance(values, dict) or "looks" not in values or "iterations" in values:
            return values
        return {"iterations" if name == "looks" else name: value for name, value in values.items()}


class FusionSettings(Settings):
    """TSDF fusion."""

    voxel_size: float | None = Field(None, description="scene units; None: from depth and focal length")
    truncation_voxels: float = Field(12.0, ge=2, description="must exceed the error of completed depth")
    min_observations: int = Field(2, ge=1, description="frames that must agree before a surface is believed")
    min_confidence: float = Field(0.1, ge=0, le=1)
    max_depth_ratio: float = Field(2.0, gt=0, description="times the median depth; farther is seen better later")
    delight: bool = Field(True, description="divide the lamp out of the colours; False keeps them as filmed")
    min_component: float = Field(0.02, ge=0, le=1, description="share of the area; smaller pieces float")


class PoseGraphSettings(Settings):
    """Places seen twice, and the poses that follow from them."""

    enabled: bool = Field(True, description="close loops inside a submap, then adjust it to its images")
    join: bool = Field(True, description="make one of submaps that show the same places")
    max_places: int = Field(
        60, ge=2, description="keyframes of a submap, evenly spaced, that are compared; more in a long one"
    )
    per_place: int = Field(3, ge=1, description="look-alikes tried for each")


class ConsistencySettings(Settings):
    """What neighbouring keyframes say against a depth, before it is fused."""

    steps: tuple[PositiveInt, ...] = Field(
        (2, 5, 10), description="keyframes away, on both sides; the nearest err alike"
    )
    tolerance: float = Field(0.04, gt=0, lt=1, description="relative; two to three times the error of completed depth")
    severity: float = Field(6.0, ge=0, description="one contradiction against none divides the confidence by 1 + this")
    max_contradicted: float = Field(0.5, gt=0, le=1, description="share of pixels beyond which a keyframe is left out")


class Config(Settings):
    """The whole run. Saved, resolved, in `run.yaml`."""

    camera: str = "auto"
    front_end: Literal["auto", "sfm", "odometry"] = "auto"
    model: str = "mscsa"
    device: Literal["auto", "cpu", "cuda"] = "auto"
    seed: int = 0
    lumen_mm: float | None = Field(None, gt=0, description="mm, median diameter of the lumen, sets the scale")
    scale_file: str | None = None
    frames: FrameSettings = FrameSettings()
    structure: StructureSettings = StructureSettings()
    odometry: OdometrySettings = OdometrySettings()
    sparse: SparseSettings = SparseSettings()
    depth: DepthSettings = DepthSettings()
    pose_graph: PoseGraphSettings = PoseGraphSettings()
    consistency: ConsistencySettings = ConsistencySettings()
    fusion: FusionSettings = FusionSettings()

    @model_validator(mode="after")
    def _asks_odometry(self) -> "Config":
        if self.front_end == "sfm" and self.odometry != OdometrySettings():
            raise ValueError("the front end sfm has no keyframe_motion (--fast) and no chunks; take odometry or auto")
        return self

    def is_same_work(self, other: "Config") -> bool:
        """Whether a run with these settings gives what one with the others does, wherever it is computed."""
        return not self.differences(other)

    def differences(self, other: "Config") -> list[str]:
        """Settings that make other work of it, as `section.name: this one's value, now the other's`."""
        mine, others = _flat(self.model_dump()), _flat(other.model_dump())
        changed = [name for name, value in mine.items() if value != others[name] and name != "odometry.ray"]
        return [f"{name}: {mine[name]}, now {others[name]}" for name in changed]


def _flat(values: dict[str, Any], section: str = "") -> dict[str, Any]:
    """Names with their sections before them."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        found |= _flat(value, f"{section}{name}.") if isinstance(value, dict) else {section + name: value}
    return found


def load_config(path: Path | None, **overrides: object) -> Config:
    """Defaults, then the YAML file, then the command line's overrides that are not None; a section's one by one."""
    values: dict[str, object] = {}
    if path is not None:
        try:
            values = yaml.safe_load(path.read_text()) or {}
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise HaustraError(f"cannot read the configuration {path}: {str(error).splitlines()[0]}") from error
        if not isinstance(values, dict):
            raise HaustraError(f"the configuration {path} is not a mapping of settings")
    for name, value in overrides.items():
        if isinstance(value, dict):
            section = values.setdefault(name, {})
            if isinstance(section, dict):  # what else the file has there is refused below
                section |= {key: given for key, given in value.items() if given is not None}
        elif value is not None:
            values[name] = value
    return validate_config(values)


def validate_config(values: dict[str, object]) -> Config:
    """A `Config`, or one sentence that names the first wrong setting."""
    try:
        return Config.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        if first["type"] == "extra_forbidden":
            raise HaustraError(f"there is no setting '{where}'") from error
        said = first["msg"].removeprefix("Value error, ")
        raise HaustraError(f"setting '{where}': {said}" if where else said) from error
