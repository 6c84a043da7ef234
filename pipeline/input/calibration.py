"""`--camera auto | PRESET | FILE` to the camera of the source's frames."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

from haustra.core.camera import Camera, guess_camera
from haustra.core.errors import HaustraError
from pipeline.input.camera_files.registry import read_lens
from pipeline.input.camera_presets import PRESETS
from pipeline.input.endomapper_scopes import colonoscope_across

# From the middle, as a share of the side; pyslam's real files go to 0.14, those without a size to 0.13. Farther off, it
# is of another size or crop.
FARTHEST_CENTRE = 0.15
MOST_BEYOND = 0.9  # share of the content: a lens that turns back before it is no lens of this picture
WORTH_SAYING = 0.01


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
            read_lens(beside)
    elif choice not in PRESETS:
        _check_not_of_run(Path(choice))
        if not Path(choice).is_file():
            raise HaustraError(f"--camera '{choice}' is neither 'auto', a file, nor a preset ({', '.join(PRESETS)})")
        read_lens(Path(choice))


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
    kind, lens = read_lens(path)
    known = path.name + (f", {kind}" if kind != path.name else "") + (f" ({lens.note})" if lens.note else "")
    if lens.size is None:
        camera = Camera(lens.model, *size, lens.params, lens.trusted)
        if any(abs(at / side - 0.5) > FARTHEST_CENTRE for at, side in zip(camera.centre, size, strict=True)):
            raise HaustraError(
                f"{path} names no picture size, and its centre ({camera.centre[0]:.0f}, {camera.centre[1]:.0f}) is not "
                f"that of frames of {size[0]}x{size[1]} pixels; say in a camera.json for which size it is"
            )
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
