"""Settings of what is given beside the pictures: poses, a sensor's depth, a second eye, the lumen's diameter.

Part of `pipeline.config`.
"""

from typing import Annotated, Any, Literal, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationInfo, field_validator, model_validator

WITHOUT_STEREO = (
    "what is said of a second eye (--stereo-layout, --stereo-right) needs the calibration of both (--stereo)"
)
TWO_LAYOUTS = (
    "the right eye has a film of its own (--stereo-right), and --stereo-layout says where both eyes lie in one "
    "picture: leave one of them out"
)
LUMEN_MM = (1, 200)  # median diameter, from a bronchus to a stomach


class Settings(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _truth_is_no_number(cls, value: Any, info: ValidationInfo) -> Any:
        """true and false, also by their other names in YAML (yes, off), are none: Python would count them 1 and 0."""
        given = value if isinstance(value, list | tuple) else [value]
        if any(isinstance(one, bool) for one in given):
            kind = cls.model_fields[str(info.field_name)].annotation
            if _holds(kind, float) and not _holds(kind, bool):
                raise ValueError(f"{' and '.join(_truths(given))} is no number; give one")
        return value


def _truths(values: Any) -> list[str]:
    """The truth values among some, as YAML writes them."""
    return sorted({str(one).lower() for one in values if isinstance(one, bool)})


def _holds(kind: Any, wanted: type) -> bool:
    """Whether an annotation is a type or a union or collection with it; float: any number."""
    if kind is wanted or (wanted is float and kind is int):
        return True
    return any(_holds(part, wanted) for part in get_args(kind))


def _lumen(diameter: float) -> float:
    low, high = LUMEN_MM
    if not low <= diameter <= high:
        raise ValueError(f"no endoscope films a lumen of {diameter:g} mm, but {low} to {high}; is the unit another?")
    return diameter


LumenMm = Annotated[float, AfterValidator(_lumen)]


class PoseSettings(Settings):
    """Camera poses that are given, so that nothing is tracked."""

    file: str | None = Field(None, description="TUM, KITTI or tracker CSV file, COLMAP model folder, transforms.json")
    hand_eye: str | None = Field(None, description="file of sensor_from_camera, sixteen numbers; for a tracker's CSV")
    refine: bool = Field(False, description="adjust the poses to the pictures; False: they stay to the last digit")
    mm_per_unit: float | None = Field(None, gt=0, description="of the file; None: its unit is kept and not called mm")

    @model_validator(mode="after")
    def _has_a_file(self) -> "PoseSettings":
        if self.file is None and (self.hand_eye is not None or self.refine or self.mm_per_unit is not None):
            raise ValueError("what is said of poses needs a file of them (--poses)")
        return self


class SensorSettings(Settings):
    """Metric depth of a sensor beside the pictures; its standard deviation is the sum of three terms."""

    depth: Literal["auto", "sensor", "none"] = Field(
        "auto", description='`auto`: used where an RGB-D folder\'s camera.json says `"depth": "sensor"`'
    )
    folder: str | None = Field(None, description="of 16-bit PNGs, one a frame; None: `depth/` of an RGB-D folder")
    unit_mm: float | None = Field(None, gt=0, description="mm of a step of the PNGs; None: as camera.json says")
    error_mm: float = Field(0.2, ge=0, description="mm, whatever the depth")
    error_relative: float = Field(0.02, ge=0, description="share of the depth")
    error_per_mm: float = Field(0.0, ge=0, description="of the depth's square, 1/mm")
    adjust: bool = Field(
        True, description="adjust odometry's maps with the depth; False: scale them as a whole, and bridge nothing"
    )
    points: Literal["gathered", "own", "none"] = Field(
        "gathered", description="given to completion: of the frames around, of the keyframe alone, or none"
    )


class StereoSettings(Settings):
    """A stereo endoscope; its depth is used as a sensor's."""

    calibration: str | None = Field(
        None, description="file of the rig: OpenCV's stereo YAML or XML, or StereoMIS's INI"
    )
    layout: Literal["side-by-side", "over-under", "interlaced"] = Field(
        "side-by-side", description="of the two eyes in a picture, the left one first"
    )
    right: str | None = Field(None, description="film of the right eye, where it has one of its own")

    @model_validator(mode="after")
    def _has_a_calibration(self) -> "StereoSettings":
        if self.calibration is None and (self.right is not None or self.layout != "side-by-side"):
            raise ValueError(WITHOUT_STEREO)
        if self.right is not None and self.layout != "side-by-side":
            raise ValueError(TWO_LAYOUTS)
        return self
