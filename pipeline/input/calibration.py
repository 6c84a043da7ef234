"""`--camera auto | PRESET | FILE` to the camera of the source's frames."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

from haustra.core.camera import Camera, guess_camera, read_camera
from haustra.core.errors import HaustraError
from pipeline.input.camera_presets import PRESETS


@dataclass(frozen=True)
class Calibration:
    """The camera of full source frames and one sentence on where it comes from."""

    camera: Camera
    origin: str


def calibrate(choice: str, source: Path, size: tuple[int, int], content: tuple[int, int, int, int]) -> Calibration:
    """Resolve the `--camera` choice for frames of size (width, height)."""
    width, height = size
    if choice == "auto":
        beside = source / "camera.json"
        if source.is_dir() and beside.exists():
            return _from_file(beside, size)
        camera = guess_camera(width, height, content)
        return Calibration(camera, "guessed: 100 degrees across the content, focal length and k1 left to SfM")
    check_choice(choice, source)
    return _from_preset(choice, size) if choice in PRESETS else _from_file(Path(choice), size)


def check_choice(choice: str, source: Path) -> None:
    """Refuse an impossible `--camera` before any work is done."""
    if choice == "auto":
        beside = source / "camera.json"
        if source.is_dir() and beside.exists():
            read_camera(beside)
    elif choice not in PRESETS:
        if not Path(choice).is_file():
            raise HaustraError(f"--camera '{choice}' is neither 'auto', a file, nor a preset ({', '.join(PRESETS)})")
        read_camera(Path(choice))


def _from_file(path: Path, size: tuple[int, int]) -> Calibration:
    camera = read_camera(path)
    if (camera.width, camera.height) != size:
        raise HaustraError(
            f"{path} is for {camera.width}x{camera.height} pixels, but the frames have {size[0]}x{size[1]}"
        )
    return Calibration(camera, f"file {path.name}")


def _from_preset(name: str, size: tuple[int, int]) -> Calibration:
    """A preset scales with the image, since recorders halve the size; another aspect ratio means another crop."""
    camera = PRESETS[name].camera
    scale = size[0] / camera.width
    if not math.isclose(size[1], camera.height * scale, abs_tol=1.5):
        raise HaustraError(
            f"preset {name} is for {camera.width}x{camera.height} pixels; "
            f"frames of {size[0]}x{size[1]} are cropped otherwise and need a camera file"
        )
    scaled = camera.cropped_and_scaled(0, 0, camera.width, camera.height, scale)
    return Calibration(replace(scaled, width=size[0], height=size[1]), f"preset {name}: {PRESETS[name].source}")
