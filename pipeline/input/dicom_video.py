"""The film inside a DICOM file (.dcm): its compressed stream, as FFmpeg reads it.

DICOM wraps H.264, HEVC, MPEG-2 or motion JPEG into fragments (PS3.5, annex A.4). Only the pixel data and the frame
rate are read; what says who the patient is stays in the file. Needs the extra `[dicom]`.
"""

import io
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from haustra.core.errors import HaustraError

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
    """By its first bytes."""
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
        return DicomVideo(io.BytesIO(b"".join(found)), "mjpeg", _rate(data))
    if not syntax.startswith(VIDEO):
        raise HaustraError(
            f"{path} holds single pictures ({data.file_meta.TransferSyntaxUID.name}) and no H.264, HEVC, MPEG-2 or "
            "motion JPEG film; convert it to one, or to a folder of pictures"
        )
    stream = b"".join(_frames(path, generate_frames, pixels, 1))
    return DicomVideo(io.BytesIO(stream), None, _rate(data))


def _frames(path: Path, generate: Any, pixels: bytes, count: int) -> list[bytes]:
    try:
        return list(generate(pixels, number_of_frames=count))
    except (ValueError, EOFError, IndexError) as error:
        raise HaustraError(f"{path} is a DICOM file whose film is cut off or damaged ({error})") from error


def _rate(data: Any) -> float:
    """Of CineRate, RecommendedDisplayFrameRate or FrameTime (ms)."""
    for name in ("CineRate", "RecommendedDisplayFrameRate"):
        if data.get(name):
            return float(data[name].value)
    return 1000 / float(data["FrameTime"].value) if data.get("FrameTime") else 0.0
