"""Every setting of `reconstruct`, with its unit and the reason for its default.

Nothing here must be set to run. A YAML file given with `--config` overrides what it names; unknown keys are refused.
Lengths in the image are shares of the working width, so that they hold at any resolution.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import Field, PositiveInt, ValidationError, model_validator

from haustra.core.errors import HaustraError
from haustra.core.text import read_text
from haustra.core.unique_yaml import load_unique
from pipeline.given_settings import LumenMm, PoseSettings, SensorSettings, Settings, StereoSettings
from pipeline.retired_settings import FIXED, OLD_SECTIONS, RENAMED, REPLACED, RETIRED

GEOMETRICAL, PHOTOMETRICAL = "_geometrical", "_photometrical"  # in the names of EndoMapper's files of lens and lamp

FAST_KEYFRAME_MOTION = 0.05  # of `--fast`: see docs/lab/front_end.md


class FrameSettings(Settings):
    """Which frames are read, and how large they are worked on."""

    start_s: float = Field(0.0, ge=0, description="s; frames before it are left out")
    end_s: float | None = Field(None, description="s; frames from it on are left out")
    stride: int = Field(1, ge=1, description="use every n-th frame")
    long_side: int = Field(480, ge=96, description="px; SIFT's precision gains little beyond, its time doubles")

    @model_validator(mode="after")
    def _ends_after_it_starts(self) -> "FrameSettings":
        if self.end_s is not None and self.end_s <= self.start_s:
            raise ValueError(f"the end (--end), {self.end_s:g} s, is not after the start (--start), {self.start_s:g} s")
        return self


class OdometrySettings(Settings):
    """How the front end `odometry` tracks the video."""

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


class FrontEndSettings(Settings):
    """What every front end gets: the settings of all of them, and the seed."""

    seed: int
    stride: int  # of the working frames in the source
    odometry: OdometrySettings
    poses: PoseSettings = PoseSettings()
    second_opinion: float = 1.0  # see `Config`
    deadline: float | None = None  # by time.monotonic(): when a front end that may be late is stopped


class DepthSettings(Settings):
    """Which frames are completed, and by what."""

    keyframe_motion: float = Field(
        0.045,
        gt=0,
        description="share of the width that shared points move by; less where a film would have under 32 keyframes",
    )
    iterations: PositiveInt | None = Field(
        None, description="of the network for each frame, at most as many as it was trained for; None: 2"
    )
    multiview: bool = Field(False, description="once more for each keyframe, with its neighbours' depths as points")
    photometric: bool = Field(True, description="corrected by where patches fit the pictures of keyframes around it")


class LoopClosingSettings(Settings):
    """Loop closing and the merging of submaps, after depth completion."""

    enabled: bool = Field(True, description="close loops inside a submap, then adjust it to its images")
    merge_submaps: bool = Field(True, description="make one of submaps that show the same places")
    max_keyframes: int = Field(
        60, ge=2, description="keyframes of a submap, evenly spaced, that are compared; more in a long one"
    )


class ConsistencySettings(Settings):
    """What neighbouring keyframes say against a depth, before it is fused."""

    steps: tuple[PositiveInt, ...] = Field(
        (1, 2, 5), description="keyframes away, on both sides; the nearest err alike"
    )
    tolerance: float = Field(0.04, gt=0, lt=1, description="relative; two to three times the error of completed depth")


class FusionSettings(Settings):
    """TSDF fusion."""

    voxel_size: float | None = Field(
        None, gt=0, description="median depths of the points, in any unit; None: from depth and focal length"
    )
    min_observations: int = Field(
        1, ge=1, description="keyframes that must have seen a surface; 2 where they are many and lie close together"
    )
    min_confidence: float = Field(0.1, ge=0, le=1, description="of depth that is fused")
    max_error_voxels: float = Field(3.0, gt=0, description="greatest expected error of depth that is fused, in voxels")
    delight: bool = Field(True, description="divide the lamp out of the colours; False keeps them as filmed")
    open_dark_spots: bool = Field(
        True, description="leave small dark spots with a bright rim open, as lids over mouths are, with `delight`"
    )
    lamp: str = Field(
        "auto",
        description="`auto`: EndoMapper's photometric file, if there is one beside the camera file; a file; or `none`",
    )


class Config(Settings):
    """The whole run. Saved, resolved, in `run.yaml`."""

    camera: str = Field("auto", description="`auto`, the name of a preset, or a camera file")
    front_end: str = Field(
        "auto", description="`auto`: odometry, and COLMAP (`sfm`) where odometry's result is doubtful; or a front end"
    )
    second_opinion: float = Field(
        1.0,
        ge=0,
        description="time that COLMAP may take to check what odometry left in doubt, over the time that odometry took "
        "(over 90 s, if that was less)",
    )
    model: str = Field("mscsa", description="completion network: a shipped name or a weight file")
    device: Literal["auto", "cpu", "cuda"] = Field("auto", description="where completion runs")
    seed: int = Field(0, ge=0, description="of every random step; the same seed gives the same bytes")
    lumen_mm: LumenMm | None = Field(None, description="mm, median diameter of the lumen, sets the scale")
    scale_file: str | None = Field(
        None, description="YAML file with `mm_per_unit`, or with `frame_a`, `frame_b` and `distance_mm`"
    )
    frames: FrameSettings = FrameSettings()
    odometry: OdometrySettings = OdometrySettings()
    poses: PoseSettings = PoseSettings()
    sensor: SensorSettings = SensorSettings()
    stereo: StereoSettings = StereoSettings()
    depth: DepthSettings = DepthSettings()
    loop_closing: LoopClosingSettings = LoopClosingSettings()
    consistency: ConsistencySettings = ConsistencySettings()
    fusion: FusionSettings = FusionSettings()

    @property
    def front_end_settings(self) -> FrontEndSettings:
        return FrontEndSettings(
            seed=self.seed,
            stride=self.frames.stride,
            odometry=self.odometry,
            poses=self.poses,
            second_opinion=self.second_opinion,
        )

    @property
    def lamp_file(self) -> Path | None:
        """By `fusion.lamp`: the file that it names, or with `auto` EndoMapper's beside the camera file; None without
        one."""
        if self.fusion.lamp != "auto":
            return None if self.fusion.lamp == "none" else Path(self.fusion.lamp)
        lens = Path(self.camera)
        beside = lens.with_name(lens.name.replace(GEOMETRICAL, PHOTOMETRICAL))
        return beside if GEOMETRICAL in lens.name and beside.is_file() else None

    def is_same_work(self, other: "Config") -> bool:
        """Whether a run with these settings gives what one with the others does, wherever it is computed."""
        return not self.differences(other)

    def differences(self, other: "Config") -> list[str]:
        """Settings that make other work of it, as `section.name: this one's value, now the other's`."""
        mine, others = _flat(self.model_dump()), _flat(other.model_dump())
        changed = [name for name, value in mine.items() if value != others[name] and name != "odometry.ray"]
        return [f"{name}: {mine[name]}, now {others[name]}" for name in changed]


def beyond_surface(differences: list[str], config: Config) -> list[str]:
    """Those of a run's `Config.differences` to `config` for which a new surface is not enough, or was not asked for: of
    settings that stages before the surface read, and of others that `config` leaves at their defaults."""
    not_default = {difference.split(":")[0] for difference in Config().differences(config)}
    names = [(one, one.split(":")[0]) for one in differences]
    return [one for one, name in names if not (_is_of_surface(name) and name in not_default)]


def _is_of_surface(name: str) -> bool:
    return name in ("scale_file", "lumen_mm", "poses.mm_per_unit") or name.startswith(("fusion.", "consistency."))


def _flat(values: dict[str, Any], section: str = "") -> dict[str, Any]:
    """Names with their sections before them."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        found |= _flat(value, f"{section}{name}.") if isinstance(value, dict) else {section + name: value}
    return found


def _names(values: dict[Any, Any]) -> Iterator[Any]:
    """Of all settings and sections, as a file has them."""
    for name, value in values.items():
        yield name
        yield from _names(value) if isinstance(value, dict) else ()


def load_config(path: Path | None, **overrides: object) -> Config:
    """Defaults, then the YAML file, then the command line's overrides that are not None; a section's one by one."""
    values: dict[str, object] = {}
    if path is not None:
        try:
            values = load_unique(read_text(path)) or {}
            json.dumps(values, default=str)  # an alias within itself has no end
        except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
            raise HaustraError(f"cannot read the configuration {path}: {str(error).splitlines()[0]}") from error
        if not isinstance(values, dict) or not all(isinstance(name, str) for name in _names(values)):
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
    for name in _flat(values):
        if name in RETIRED:
            raise HaustraError(f"there is no setting '{name}' any more, it is fixed at {FIXED[name]:g}; remove it")
        if name in REPLACED:
            raise HaustraError(f"there is no setting '{name}' any more, '{REPLACED[name][0]}' has taken its place")
        if name.split(".")[0] in OLD_SECTIONS and name not in RENAMED:
            raise HaustraError(f"there is no setting '{name}'")
    try:
        return Config.model_validate(_with_new_names(values))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        if first["type"] == "extra_forbidden":
            raise HaustraError(f"there is no setting '{where}'") from error
        said = first["msg"].removeprefix("Value error, ")
        raise HaustraError(f"setting '{where}': {said}" if where else said) from error


def _with_new_names(values: dict[str, object]) -> dict[str, object]:
    """Settings by the names that they have today; `RENAMED` ones keep their values."""
    found = dict(values)
    for old, new in RENAMED.items():
        (section, name), (target, key) = old.split("."), new.split(".")
        given = found.get(section)
        if isinstance(given, dict) and name in given:
            found[section] = {k: v for k, v in given.items() if k != name}
            others = found.get(target)
            found[target] = {key: given[name]} | (others if isinstance(others, dict) else {})
            if not found[section]:
                del found[section]
    return found


def read_recorded(values: dict[str, object]) -> Config:
    """The configuration of a run's record, which may be of an earlier version, without retired settings."""
    known: dict[str, object] = {}
    for name, value in _with_new_names(values).items():
        if isinstance(value, dict):
            kept = {key: given for key, given in value.items() if f"{name}.{key}" not in (*RETIRED, *REPLACED)}
            if value and not kept and name not in Config.model_fields:
                continue  # a section of which every setting was retired
            value = kept
            if name == "stereo" and value.get("calibration") is None:
                value = {}  # what earlier versions took of a second eye without a calibration changed nothing
        known[name] = value
    return validate_config(known)


def retired_differences(values: dict[str, Any]) -> list[str]:
    """Retired settings in a run's record that were not left at their defaults, as `Config.differences` has them."""
    recorded = _flat(values)
    replaced = [
        f"{old}: {recorded[old]}, whose place {new} has taken"
        for old, (new, default) in REPLACED.items()
        if recorded.get(old, default) != default
    ]
    return replaced + [
        f"{name}: {recorded[name]}, now fixed at {FIXED[name]:g}"
        for name, default in RETIRED.items()
        if name in recorded and recorded[name] not in (default, FIXED[name])
    ]
