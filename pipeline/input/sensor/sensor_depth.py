"""Depth images of a sensor that looks through the camera's lens: sparse, holed and noisy, in millimetres.

One uint16 PNG a frame; 0 = none, and so is 65535, which sensors write where nothing returns. Its grid covers the whole
source picture, however coarse it is. A value is z-depth along the camera's axis.
"""

import re
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import HaustraError
from haustra.core.natural_order import in_natural_order
from haustra.core.text import read_json
from pipeline.config import SensorSettings
from pipeline.input.frames import SENSED_MM
from pipeline.input.image_folder import images_of, rows_by_number
from pipeline.input.sensor.usual_distances import check_unit
from pipeline.run_folder.workspace import Workspace

Array = NDArray[np.float64]
SENSOR = "sensor"  # what an RGB-D folder's camera.json calls depth that is no truth
LEAST_CONFIDENCE = 1 / 255  # of a confidence image; 0 is no depth
MOST_SHARE = 0.1  # of depth, symmetric noise that is corrected for; the rule is of second order
CACHED = 8
LEAST_COVERED = 0.05  # of a film's frames: a slower sensor than the camera has fewer images
ANEW = "copy it anew, or delete it, and its frame has no depth"
MOST_STRETCH = 0.02  # of a depth image's height, or one cell: beyond, its cells are not square
PNG_HEAD, PNG_TAIL, GREY_16 = b"\x89PNG\r\n\x1a\n", 1024, b"\x10\x00"
NO_RETURN = np.iinfo(np.uint16).max  # at 0.01 mm a step it would be a wall 655 mm away
LOOKED_AT = 20  # images, spread over the film, by which the unit is checked before any work


@dataclass(frozen=True)
class SensorDepth:
    """files: depth image by frame number. settings: unit and error. box: x, y, width, height of the content in the
    source picture; scale: from it to the working picture; size: (width, height) of the source picture; stereo: by the
    second eye, whose unit is the rig's baseline."""

    files: dict[int, Path]
    settings: SensorSettings
    unit_mm: float
    box: tuple[int, int, int, int]
    scale: float
    size: tuple[int, int]
    stereo: bool = False

    @cached_property
    def spacing_px(self) -> float:
        """Working pixels from one of the sensor's cells to the next."""
        return 1.0 if self._grid is None else self.size[0] * self.scale / self._grid[1]

    @cached_property
    def _grid(self) -> tuple[int, int] | None:
        """Height and width of the depth images, by the first; None without any."""
        first = self.image(min(self.files)) if self.files else None
        return None if first is None else (first[0].shape[0], first[0].shape[1])

    @property
    def doubt_of_shape(self) -> str:
        """A sentence where depth images have another ratio of sides than the source picture; empty otherwise."""
        if self._grid is None:
            return ""
        (height, width), (wide, high) = self._grid, self.size
        if abs(height - high * width / wide) <= max(1, MOST_STRETCH * height):
            return ""
        return (
            f"depth images of {width}x{height} px are stretched over pictures of {wide}x{high}, which is right where "
            "they show the whole picture; of a crop of it, depth and millimetres are wrong"
        )

    def image(self, frame: int) -> tuple[Array, Array] | None:
        """(h,w) depth in mm, 0 = none, and (h,w) its standard deviation, mm; None for a frame without an image."""
        path = self.files.get(frame)
        if path is None:
            return None
        raw = _read_depth(path)
        depth = raw * self.unit_mm
        sigma = self.settings.error_mm + self.settings.error_relative * depth + self.settings.error_per_mm * depth**2
        trust = _confidence(path, raw.shape)
        return np.where(trust >= LEAST_CONFIDENCE, depth, 0.0), sigma / np.maximum(trust, LEAST_CONFIDENCE)

    def at(self, frame: int, pixels: Array) -> Array:
        """(K,) depth in mm at working pixels (K,2), of the sensor's cell there; 0 = none."""
        return self.measured(frame, pixels)[0]

    def measured(self, frame: int, pixels: Array) -> tuple[Array, Array]:
        """(K,) depth in mm at working pixels (K,2), of the sensor's cell there, and (K,) its standard deviation, mm;
        both 0 where there is none."""
        found = _cached_image(self, frame)
        if found is None:
            return np.zeros(len(pixels)), np.zeros(len(pixels))
        depth, sigma = found
        source = pixels / self.scale + np.array(self.box[:2])
        cell = np.floor(source / np.array(self.size) * np.array(depth.shape[::-1])).astype(int)
        column, row = np.clip(cell, 0, np.array(depth.shape[::-1]) - 1).T
        known = ((cell >= 0) & (cell < depth.shape[::-1])).all(axis=1) & (depth[row, column] > 0)
        return np.where(known, depth[row, column], 0.0), np.where(known, sigma[row, column], 0.0)

    def for_adjustment(self, frame: int, pixels: Array) -> tuple[Array, Array]:
        """As `measured`, for residuals that are linear in the inverse depth (`depth_residuals`).

        Noise that grows with the square of depth, as a stereo pair's, is symmetric in the inverse. Noise that is
        symmetric in depth itself and is the share s of it would bring their least squares out s^2 too deep: 0.09 % at
        3 %. That much is taken off, by the error that is stated; confidence weighs, and has no part in it. Where the
        stated error is not the real one, neither is the correction; of the bias of an error that is the same at all
        depths (`error_mm`), 3 s^2, it is a third.
        """
        depth, sigma = self.measured(frame, pixels)
        even = self.settings.error_mm + self.settings.error_relative * depth
        share = np.divide(even, depth, out=np.zeros(len(depth)), where=depth > 0)
        return depth * (1 - np.minimum(share, MOST_SHARE) ** 2), sigma

    def cells(self, frame: int) -> tuple[Array, Array, Array] | None:
        """Working pixels (K,2) of the middles of the cells that have depth, their depth (K,) and standard deviation
        (K,), mm; None for a frame without an image."""
        found = self.image(frame)
        if found is None:
            return None
        depth, sigma = (values.ravel() for values in found)
        known = np.flatnonzero(depth > 0)
        height, width = found[0].shape
        row, column = np.divmod(known, width)
        pixels = self.working_pixels((np.stack([column, row], axis=1) + 0.5) / [width, height])
        return pixels, depth[known], sigma[known]

    def working_pixels(self, shares: Array) -> Array:
        """(K,2) of places in a depth image, x and y (K,2) as shares of its width and height."""
        return np.asarray((shares * np.array(self.size) - np.array(self.box[:2])) * self.scale)

    def __hash__(self) -> int:
        return id(self)


@lru_cache(CACHED)
def _cached_image(sensor: SensorDepth, frame: int) -> tuple[Array, Array] | None:
    return sensor.image(frame)


def _fault(path: Path) -> str:
    """What is wrong with a depth image, by its first and last bytes; empty where nothing is."""
    with path.open("rb") as file:
        head = file.read(len(PNG_HEAD) + 18)  # and the header's length, name, width, height, bits and kind
        file.seek(max(0, path.stat().st_size - PNG_TAIL))
        whole = b"IEND" in file.read()
    if not head.startswith(PNG_HEAD) or head[-2:] != GREY_16:
        return "is no 16-bit depth image"
    return "" if whole else f"is a depth image that is cut off: {ANEW}"


def _read_depth(path: Path) -> NDArray[np.uint16]:
    """(h,w) as stored, and 0 wherever there is none. HaustraError for any other image."""
    raw = _stored(path)
    return np.where(raw == NO_RETURN, np.uint16(0), raw)


def _stored(path: Path) -> NDArray[np.uint16]:
    """(h,w) of a depth image. HaustraError for any other image."""
    raw = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if raw is None or raw.ndim != 2 or raw.dtype != np.uint16:
        fault = _fault(path) or f"is a damaged depth image: {ANEW}; then go on with --resume"
        raise HaustraError(f"{path} {fault}")
    return np.asarray(raw, np.uint16)


def _confidence(path: Path, shape: tuple[int, ...]) -> Array:
    """(h,w) of `confidence/` beside the depth folder, in [0,1]; 1 where there is none."""
    beside = path.parent.parent / "sensor_confidence" / path.name
    if not beside.is_file():
        return np.ones(shape)
    image = cv2.imread(str(beside), cv2.IMREAD_GRAYSCALE)
    if image is None or image.shape != shape:
        raise HaustraError(f"{beside} is no 8-bit confidence of the size of its depth")
    return image / 255.0


def depth_folder(source: Path, settings: SensorSettings) -> Path | None:
    """Where the sensor's depth of a source lies; None where there is none, or it is not to be used."""
    if settings.depth == "none":
        return None
    if settings.folder is not None:
        return Path(settings.folder)
    described = source / "camera.json"
    says = source.is_dir() and described.is_file() and str(read_json(described).get("depth")).lower() == SENSOR
    if says or (settings.depth == SENSOR and (source / "depth").is_dir()):
        return source / "depth"
    if settings.depth == SENSOR:
        raise HaustraError(f"{source} has no depth/ of a sensor; say where it is by --depth-folder")
    return None


def check_sensor(source: Path, settings: SensorSettings, announced: int) -> str:
    """Refuse what cannot work before any work is done; a sentence on values that were taken for no depth, empty without
    such. announced: frames that the source claims, 0 = unknown."""
    folder = depth_folder(source, settings)
    if folder is None and settings.unit_mm is not None and settings.depth != "none":
        raise HaustraError(
            f"the unit of a sensor's depth is given (--depth-unit-mm), but no depth of {source}: say where it is by "
            "--depth-folder"
        )
    if folder is None:
        return ""
    unit_mm, images = _unit(source, folder, settings), sorted(folder.glob("[!.]*.png"))
    if not images:
        raise HaustraError(f"{folder} holds no depth images (16-bit PNG)")
    for path in images:
        if fault := _fault(path):
            raise HaustraError(f"{path} {fault}")
    looked_at = images[:: -(-len(images) // LOOKED_AT)]
    stored = [_stored(path) for path in looked_at]
    known = np.concatenate([_known(path, raw) for path, raw in zip(looked_at, stored, strict=True)])
    if len(known) == 0:
        raise HaustraError(
            f"the {len(looked_at)} images of {folder} that were looked at hold no depth: all are 0 or {NO_RETURN}"
        )
    check_unit(unit_mm * float(np.median(known)), stereo=False)
    of_frames = sum(number < announced for number in _by_frame(source, folder, True))
    if of_frames < LEAST_COVERED * announced:
        raise HaustraError(
            f"{of_frames} of the {len(images)} depth images of {folder} are of the film's {announced} frames, by the "
            "numbers in their names: give those of this film"
        )
    share = float(np.mean([np.mean(raw == NO_RETURN) for raw in stored]))
    if share == 0:
        return ""
    percent = f"{100 * share:.0f}" if share >= 0.01 else "less than 1"
    values = (
        f"{percent} % of the values in {len(looked_at)} of the sensor's depth images are {NO_RETURN}, the largest of"
    )
    return f"{values} 16 bits: taken for no depth, as 0 is"


def _known(path: Path, raw: NDArray[np.uint16]) -> Array:
    """(K,) values of a depth image, as stored (h,w), that are depth."""
    return raw[(raw > 0) & (raw < NO_RETURN) & (_confidence(path, raw.shape) >= LEAST_CONFIDENCE)].astype(np.float64)


def open_sensor(workspace: Workspace, width: int) -> SensorDepth | None:
    """The sensor of a run, whose working pictures have that width; None where it has none."""
    if "source" not in workspace.record:  # frames that did not come from a film
        return None
    source, settings = Path(workspace.record["source"]["path"]), workspace.config.sensor
    folder = depth_folder(source, settings)
    if workspace.config.stereo.calibration is not None and settings.depth != "none":
        folder, settings = workspace.sensor, _stereo_settings(workspace)
    if folder is None:
        return None
    record = workspace.result("frames")
    x, y, *box = record["content_box"]
    size, stereo = (record["source_size"][0], record["source_size"][1]), folder == workspace.sensor
    files = _by_frame(source, folder, not stereo)
    unit_mm = _unit(source, folder, settings)
    return SensorDepth(files, settings, unit_mm, (x, y, box[0], box[1]), width / box[0], size, stereo)


def _stereo_settings(workspace: Workspace) -> SensorSettings:
    """Unit and error of the depth that the frames stage wrote: its error grows with the square."""
    per_mm = float(workspace.result("frames")["depth_error_per_mm"])
    errors = {"error_mm": 0.0, "error_relative": 0.003, "error_per_mm": per_mm}
    return workspace.config.sensor.model_copy(update={"unit_mm": SENSED_MM} | errors)


def _by_frame(source: Path, folder: Path, by_name: bool) -> dict[int, Path]:
    """By the name of a folder's picture, else by the number in both their names, else by the number as from 0."""
    files = in_natural_order(list(folder.glob("[!.]*.png")))
    pictures = images_of(source)[0] if by_name and source.is_dir() else []
    names = {path.stem: number for number, path in enumerate(pictures)}
    if any(path.stem in names for path in files):
        return {names[path.stem]: path for path in files if path.stem in names}
    numbered = {int(found[-1]): path for path in files if (found := re.findall(r"\d+", path.stem))}
    if not numbered:
        raise HaustraError(f"the depth images in {folder} carry no frame numbers in their names")
    rows = rows_by_number([path.name for path in pictures], [path.name for path in files])
    return numbered if rows is None else {rows[number]: path for number, path in numbered.items()}


def _unit(source: Path, folder: Path, settings: SensorSettings) -> float:
    """Millimetres of one step of the PNGs."""
    if settings.unit_mm is not None:
        return settings.unit_mm
    for described in (source / "camera.json", folder.parent / "camera.json", folder / "camera.json"):
        if described.is_file() and "depth_unit_mm" in (about := read_json(described)):
            return _length(about["depth_unit_mm"], described)
    raise HaustraError(f"the unit of the depth in {folder} is not known: say it by --depth-unit-mm")


def _length(said: object, path: Path) -> float:
    """Of a step, mm, as a file says it. HaustraError where that is no length."""
    try:
        unit_mm = 0.0 if isinstance(said, bool) else float(said)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        unit_mm = 0.0
    if not 0 < unit_mm < np.inf:
        raise HaustraError(f"depth_unit_mm in {path} is {str(said)[:20]}, no length of a step of the depth")
    return unit_mm
