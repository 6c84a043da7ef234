"""Frames out of a video file, an image folder or an RGB-D folder: index, time in seconds, RGB pixels."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import HaustraError

if TYPE_CHECKING:
    from av.container import InputContainer

IMAGE_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff"}
FOLDER_FPS = 30.0  # of an image folder without camera.json; times are then nominal


@dataclass(frozen=True)
class RawFrame:
    """One decoded frame: its index in the source, time in seconds, (H,W,3) uint8 RGB."""

    index: int
    seconds: float
    rgb: NDArray[np.uint8]


class Source:
    """A video or folder that can be read from its beginning as often as needed.

    Attributes: path; announced (number of frames that the source claims, 0 = unknown); notes (sentences about what
    was amiss while reading, filled by iteration).
    """

    def __init__(self, path: Path) -> None:
        if not path.exists():
            raise HaustraError(f"there is no file or folder {path}")
        self.path = path
        self.notes: list[str] = []
        self.is_folder = path.is_dir()
        self.images = _images_of(path) if self.is_folder else []
        if self.is_folder and not self.images:
            raise HaustraError(f"the folder {path} holds no images")
        if not self.is_folder and path.stat().st_size == 0:
            raise HaustraError(f"the file {path} is empty")
        self.announced = len(self.images) if self.is_folder else _announced_frames(path)

    def __iter__(self) -> Iterator[RawFrame]:
        return self._read_folder() if self.is_folder else self._read_video()

    def _read_folder(self) -> Iterator[RawFrame]:
        size = None
        for index, path in enumerate(self.images):
            image = cv2.imread(str(path), cv2.IMREAD_COLOR)
            if image is None:
                self._note(f"{path.name} is not a readable image and was skipped")
                continue
            size = size or image.shape
            if image.shape != size:
                raise HaustraError(f"{path.name} has another size than the images before it in {path.parent}")
            yield RawFrame(index, index / FOLDER_FPS, np.ascontiguousarray(image[..., ::-1]))

    def _read_video(self) -> Iterator[RawFrame]:
        import av

        count = 0
        with open_video(self.path) as container:
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            rate = float(stream.average_rate or 30)
            try:
                for frame in container.decode(stream):
                    rgb = frame.to_ndarray(format="rgb24")
                    seconds = frame.time if frame.time is not None else count / rate
                    # FFmpeg's rotation is the counter-clockwise turn that makes the picture upright.
                    yield RawFrame(count, float(seconds), np.ascontiguousarray(np.rot90(rgb, frame.rotation // 90)))
                    count += 1
            except av.error.FFmpegError as error:
                self._note(f"decoding stopped after {count} frames ({error.strerror}); they are used")
        if count == 0:
            raise HaustraError(f"no frame of {self.path} can be decoded")
        if count < 0.98 * self.announced:
            self._note(f"the video ends early: {count} of {self.announced} announced frames could be decoded")

    def _note(self, sentence: str) -> None:
        if sentence not in self.notes:
            self.notes.append(sentence)


def open_video(path: Path) -> "InputContainer":
    """An open PyAV container with a video stream; one sentence if there is none."""
    import av

    try:
        container = av.open(str(path))
    except (av.error.FFmpegError, ValueError, OSError) as error:
        raise HaustraError(f"{path} is not a video that FFmpeg can read (or its index is cut off)") from error
    if not container.streams.video:
        container.close()
        raise HaustraError(f"{path} holds no video stream")
    return container


def _announced_frames(path: Path) -> int:
    with open_video(path) as container:
        return container.streams.video[0].frames


def _images_of(folder: Path) -> list[Path]:
    """The images of an image folder, or of the `rgb/` of an RGB-D folder, in name order.

    A folder that mixes images with depth maps or masks (SimCol3D: `Depth_*`) gives its colour frames only.
    """
    inner = folder / "rgb" if (folder / "rgb").is_dir() else folder
    found = sorted(p for p in inner.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES)
    return [p for p in found if not any(word in p.stem.lower() for word in ("depth", "mask"))]
