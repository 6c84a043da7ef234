"""`--camera auto | PRESET | FILE` to the camera of the source's frames."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from haustra.core.camera import Camera, guess_camera
from haustra.core.errors import HaustraError
from pipeline.input.camera_files.calibrated_lens import CalibratedLens
from pipeline.input.camera_files.registry import read_lens
from pipeline.input.camera_presets import PRESETS
from pipeline.input.endomapper_scopes import colonoscope_across

# From the middle, as a share of the side; pyslam's real files go to 0.14, those without a size to 0.13. Farther off, it
# is of another size or crop.
FARTHEST_CENTRE = 0.15
MOST_BEYOND = 0.9  # share of the content: a lens that turns back before it is no lens of this picture
WORTH_SAYING = 0.01
# Of the two focal lengths. Frames are stretched until their pixels are square, and real files go to 1.011. A film that
# does not say the shape of its pixels may keep them as stored: single fields, and one eye of two side by side, have
# pixels twice as high as wide or wide as high, of DV a little more.
MOST_FOCAL_RATIO = 2.3
MOST_OFF = 1.0  # sides of the picture by which the centre may lie outside it: a crop need not show the axis
LEAST_VIEW_DEG = 4.0  # endoscopes see 30 degrees and more, a microscope or an exoscope over the patient about 6
TANGENTIAL = ("OPENCV", "FULL_OPENCV")  # models with p1 and p2
MOST_FOLDED = 0.1  # share of the picture that they may cost; those of real files, to 0.014, cost nothing
GRID = 48  # points a side at which that is asked


@dataclass(frozen=True)
class Calibration:
    """The camera of full source frames, one sentence on where it comes from, and whether that is a mere guess."""

    camera: Camera
    origin: str
    guessed: bool = False


def calibrate(
    choice: str, source: Path, size: tuple[int, int], content: tuple[int, int, int, int], cut_corners: bool = False
) -> Calibration:
    """Resolve the `--camera` choice for frames of size (width, height); cut_corners: the content's are masked."""
    width, height = size
    if choice == "auto":
        beside = source / "camera.json"
        if source.is_dir() and beside.exists():
            return _reaching(_from_file(beside, size), beside, content)
        if cut_corners:
            camera = colonoscope_across(width, height, content)
            return Calibration(camera, "guessed: mean of 18 colonoscopes, whose corners are masked too", True)
        camera = guess_camera(width, height, content)
        return Calibration(camera, "guessed: 100 degrees across the content", True)
    check_choice(choice, source)
    if choice in PRESETS:
        return _from_preset(choice, size)
    return _reaching(_from_file(Path(choice), size), Path(choice), content)


def check_choice(choice: str, source: Path) -> None:
    """Refuse an impossible `--camera` before any work is done."""
    if choice == "auto":
        beside = source / "camera.json"
        if source.is_dir() and beside.exists():
            _read(beside)
    elif choice not in PRESETS:
        _check_not_of_run(Path(choice))
        if not Path(choice).is_file():
            raise HaustraError(f"--camera '{choice}' is neither 'auto', a file, nor a preset ({', '.join(PRESETS)})")
        _read(Path(choice))


def _read(path: Path) -> tuple[str, CalibratedLens]:
    """A camera file's format and lens. HaustraError for a lens that cannot be of the picture size that it names."""
    kind, lens = read_lens(path)
    if lens.size is not None:
        refuse_impossible(Camera(lens.model, *lens.size, lens.params), f"the lens of {path}")
    return kind, lens


def refuse_impossible(camera: Camera, which: str, most_ratio: float = MOST_FOCAL_RATIO) -> None:
    """HaustraError, one sentence about `which` lens, for numbers that no camera has: they would let every later stage
    fail, and the film would be blamed. most_ratio: of the focal lengths."""
    (fx, fy), (cx, cy) = camera.focal, camera.centre
    size, wrong = f"{camera.width}x{camera.height} pixels", ""
    ratio, view, folded = max(fx, fy) / min(fx, fy), max(camera.field_of_view()), 0.0
    if ratio > most_ratio:
        wrong = (
            f"its focal lengths, {fx:.6g} and {fy:.6g} px, differ by a factor of {ratio:.3g}, and no film's pixels "
            f"are further from square than by a factor of {most_ratio:g}"
        )
    elif max(abs(cx / camera.width - 0.5), abs(cy / camera.height - 0.5)) > 0.5 + MOST_OFF:
        wrong = f"its centre ({cx:.6g}, {cy:.6g}) lies far outside its picture of {size}"
    elif view < LEAST_VIEW_DEG:
        wrong = (
            f"by its focal length, {camera.focal_px:.6g} px, and its distortion it sees {view:.2g} degrees across "
            f"{size}, and no endoscope sees less than {LEAST_VIEW_DEG:g}"
        )
    elif (folded := _share_folded(camera)) > MOST_FOLDED:
        p1, p2 = camera.distortion[2:4]
        wrong = (
            f"its tangential terms, p1 = {p1:.6g} and p2 = {p2:.6g}, fold the picture onto itself: no ray belongs to "
            f"{100 * folded:.0f} % of it"
        )
    if wrong:
        raise HaustraError(f"{which} is impossible: {wrong}; are the numbers right, and in their order?")


def _share_folded(camera: Camera) -> float:
    """Share of the picture to which no ray belongs because of the tangential terms, and one would without them."""
    if camera.model not in TANGENTIAL or not any(camera.distortion[2:4]):
        return 0.0
    steps = (np.arange(GRID) + 0.5) / GRID
    columns, rows = np.meshgrid(steps * camera.width, steps * camera.height)
    pixels = np.column_stack([columns.ravel(), rows.ravel()])
    plane, known = camera.unproject(pixels)
    known &= np.linalg.det(camera.pixel_jacobian(plane)) > 0  # negative where the picture is folded over
    _, reached = replace(camera, params=(*camera.params[:6], 0.0, 0.0, *camera.params[8:])).unproject(pixels)
    return float((reached & ~known).mean())


def _check_not_of_run(path: Path) -> None:
    """A run has more than one camera file, and one of them is that of its film."""
    folder = path if path.is_dir() else path.parent
    lens = folder / "lens.json"
    if not (folder / "run.yaml").is_file() or not lens.is_file() or path == lens:
        return
    if path.is_dir():
        raise HaustraError(f"--camera {path} is the folder of a run; its lens is {lens}")
    if path.name.startswith("camera"):
        raise HaustraError(f"{path} is the pinhole of that run's depth maps, and not its film's lens, which is {lens}")


def _from_file(path: Path, size: tuple[int, int]) -> Calibration:
    """A file's lens scales with the picture too; one without a size is taken for these frames where that can be."""
    kind, lens = _read(path)
    known = path.name + (f", {kind}" if kind != path.name else "") + (f" ({lens.note})" if lens.note else "")
    if lens.size is None:
        camera = Camera(lens.model, *size, lens.params, lens.trusted)
        if any(abs(at / side - 0.5) > FARTHEST_CENTRE for at, side in zip(camera.centre, size, strict=True)):
            raise HaustraError(
                f"{path} names no picture size, and its centre ({camera.centre[0]:.0f}, {camera.centre[1]:.0f}) is not "
                f"that of frames of {size[0]}x{size[1]} pixels; say in a camera.json for which size it is"
            )
        refuse_impossible(camera, f"the lens of {path}")
        return Calibration(camera, f"file {known}, which names no size: taken for {size[0]}x{size[1]} pixels")
    camera = Camera(lens.model, *lens.size, lens.params, lens.trusted)
    if lens.size == size:
        return Calibration(camera, f"file {known}")
    scaled = scaled_to(camera, size)
    if scaled is None:
        raise HaustraError(
            f"{path} is for {camera.width}x{camera.height} pixels, but the frames have {size[0]}x{size[1]}, "
            "which is another crop and not another scale; give a calibration of these frames, or leave --camera out"
        )
    return Calibration(scaled, f"file {known}, scaled from {camera.width}x{camera.height} pixels")


def _reaching(found: Calibration, path: Path, content: tuple[int, int, int, int]) -> Calibration:
    """Refuse a file's lens whose polynomial turns back near the content's middle; say where it does farther out."""
    camera = found.camera
    beyond = camera.share_beyond_lens(content)
    if beyond <= WORTH_SAYING:
        return found
    degrees = math.degrees(camera.lens.valid_angle(camera.distortion))
    turns = f"its polynomial turns back {degrees:.0f} degrees off the axis, and {100 * beyond:.0f} % of the picture is"
    if beyond > MOST_BEYOND:
        raise HaustraError(
            f"the lens of {path} is none of this picture: {turns} beyond; are the coefficients those of "
            f"{camera.model}, and in its order?"
        )
    return replace(found, origin=f"{found.origin}; {turns} beyond, unused")


def _from_preset(name: str, size: tuple[int, int]) -> Calibration:
    camera = PRESETS[name].camera
    scaled = scaled_to(camera, size)
    if scaled is None:
        raise HaustraError(
            f"preset {name} is for {camera.width}x{camera.height} pixels; frames of {size[0]}x{size[1]} are cropped "
            "otherwise: leave --camera out, and the lens is found from the film, or give a camera file"
        )
    return Calibration(scaled, f"preset {name}: {PRESETS[name].source}")


def scaled_to(camera: Camera, size: tuple[int, int]) -> Camera | None:
    """The camera of its pictures brought to `size`, as recorders do; None where the sides' ratio is another, which
    means another crop."""
    scale = size[0] / camera.width
    if not math.isclose(size[1], camera.height * scale, abs_tol=1.5):
        return None
    scaled = camera.cropped_and_scaled(0, 0, camera.width, camera.height, scale)
    return replace(scaled, width=size[0], height=size[1])
