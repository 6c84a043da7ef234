"""The film inside a DICOM file (.dcm): its compressed stream, as FFmpeg reads it.

DICOM wraps H.264, HEVC, MPEG-2 or motion JPEG into fragments (PS3.5, annex A.4). Only the pixel data and the frame
rate are read; what says who the patient is stays in the file. Needs the extra `[dicom]`.
"""

import io
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from haustra.core.errors import HaustraError
from pipeline.input.image_folder import MOST_FPS

PREAMBLE, MAGIC = 128, b"DICM"
MOTION_JPEG = ("1.2.840.10008.1.2.4.50", "1.2.840.10008.1.2.4.51", "1.2.840.10008.1.2.4.70")
VIDEO = ("1.2.840.10008.1.2.4.10",)  # MPEG-2 .100 and .101, MPEG-4 AVC .102 to .106, HEVC .107 and .108
NO_PYDICOM = "reading a DICOM video needs pydicom: pip install 'haustra[dicom]'"


@dataclass(frozen=True)
class DicomVideo:
    """stream: what FFmpeg is given. kind: FFmpeg's name of it, None where FFmpeg finds it out. rate: frames/s, 0 where
    the file does not say."""

    stream: io.BytesIO
    kind: str | None
    rate: float


def is_dicom(path: Path) -> bool:
    """Whether a file is DICOM, by its first bytes."""
    with path.open("rb") as file:
        return file.read(PREAMBLE + len(MAGIC))[PREAMBLE:] == MAGIC


def read_dicom_video(path: Path) -> DicomVideo:
    """The film. HaustraError, one sentence, where there is none or the file is cut off."""
    try:
        import pydicom
        from pydicom.encaps import generate_frames
    except ImportError as error:
        raise HaustraError(NO_PYDICOM) from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of an end that is missing, which is told below
            data = pydicom.dcmread(path)
        syntax = str(data.file_meta.TransferSyntaxUID)
        pixels, count = data.PixelData, int(data.get("NumberOfFrames", 1))
    except (pydicom.errors.InvalidDicomError, AttributeError, EOFError, ValueError, KeyError, OSError) as error:
        raise HaustraError(f"{path} is a DICOM file without a film that can be read, or cut off") from error
    if syntax in MOTION_JPEG:
        found = list(_frames(path, generate_frames, pixels, count))
        if len(found) < count:
            raise HaustraError(f"{path} is cut off: it holds {len(found)} of {count} frames")
        return DicomVideo(io.BytesIO(b"".join(found)), "mjpeg", _rate(data, path))
    if not syntax.startswith(VIDEO):
        raise HaustraError(
            f"{path} holds single pictures ({data.file_meta.TransferSyntaxUID.name}) and no H.264, HEVC, MPEG-2 or "
            "motion JPEG film; convert it to one, or to a folder of pictures"
        )
    stream = b"".join(_frames(path, generate_frames, pixels, 1))
    return DicomVideo(io.BytesIO(stream), None, _rate(data, path))


def _frames(path: Path, generate: Any, pixels: bytes, count: int) -> list[bytes]:
    try:
        return list(generate(pixels, number_of_frames=count))
    except (ValueError, EOFError, IndexError) as error:
        raise HaustraError(f"{path} is a DICOM file whose film is cut off or damaged ({error})") from error


def _rate(data: Any, path: Path) -> float:
    """Of CineRate, RecommendedDisplayFrameRate, FrameTime or the mean of FrameTimeVector (ms)."""
    name = ""
    try:
        for name in ("CineRate", "RecommendedDisplayFrameRate", "FrameTime", "FrameTimeVector"):
            said = np.ravel(data[name].value if data.get(name) else 0).astype(float)
            times = said[1:] if len(said) > 1 else said  # the first of a vector is zero
            if times.any():
                rate = float(1000 / times.mean() if name.startswith("FrameTime") else times.mean())
                break
        else:
            return 0.0
    except (ValueError, TypeError, OverflowError):
        rate = 0.0
    if not 0 < rate < MOST_FPS:
        raise HaustraError(f"{name} of {path} gives no number of frames a second; correct it, or take the film out")
    return rate
