"""COLMAP's `cameras.txt` and `cameras.bin` (colmap.github.io/format.html)."""

import struct
from pathlib import Path

from haustra.core.errors import HaustraError
from haustra.core.lenses import LENS_MODELS
from pipeline.input.camera_files.calibrated_lens import CalibratedLens
from pipeline.input.camera_files.document import CameraDocument

# Numbers of the models in cameras.bin, and how many parameters each has.
BINARY_MODELS = {
    0: ("SIMPLE_PINHOLE", 3),
    1: ("PINHOLE", 4),
    2: ("SIMPLE_RADIAL", 4),
    3: ("RADIAL", 5),
    4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8),
    6: ("FULL_OPENCV", 12),
    7: ("FOV", 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5),
    10: ("THIN_PRISM_FISHEYE", 12),
}


def read_colmap(document: CameraDocument) -> CalibratedLens | None:
    if document.path.suffix == ".bin":
        cameras = _binary(document.path) if document.path.name == "cameras.bin" else {}
    else:
        cameras = cameras_of_text(document.text)
    if not cameras:
        return None
    lenses = list(cameras.values())
    if any(lens != lenses[0] for lens in lenses):
        raise HaustraError(f"it has {len(lenses)} cameras that differ; keep the line of one")
    return lenses[0]


def cameras_of_text(text: str) -> dict[int, CalibratedLens]:
    """Lines of `id MODEL width height params`; none where the text is anything else."""
    cameras = {}
    for line in text.splitlines():
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) < 6 or not words[0].isdigit() or not words[1].isupper():
            return {}
        size = int(words[2]), int(words[3])
        cameras[int(words[0])] = _lens(words[1], [float(word) for word in words[4:]], size)
    return cameras


def _binary(path: Path) -> dict[int, CalibratedLens]:
    data, cameras, place = path.read_bytes(), {}, 8
    try:
        (count,) = struct.unpack_from("<Q", data)
        for _ in range(count):
            number, model, width, height = struct.unpack_from("<IiQQ", data, place)
            if model not in BINARY_MODELS:
                raise HaustraError(f"{path} has a camera model of number {model}, which haustra does not know")
            name, parameters = BINARY_MODELS[model]
            cameras[number] = _lens(
                name, list(struct.unpack_from(f"<{parameters}d", data, place + 24)), (width, height)
            )
            place += 24 + 8 * parameters
    except struct.error as error:
        raise HaustraError(f"{path} is cut off") from error
    return cameras


def _lens(model: str, params: list[float], size: tuple[int, int]) -> CalibratedLens:
    if model not in LENS_MODELS:
        raise HaustraError(f"its lens model {model} is none of {', '.join(LENS_MODELS)}")
    return CalibratedLens(model, tuple(params), size)
