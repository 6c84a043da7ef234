"""Frames out of a video file, an image folder or an RGB-D folder: index, time in seconds, RGB pixels."""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import HaustraError

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import InputContainer

IMAGE_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff"}
MAX_DAMAGED = 10_000  # packets; a stream that never ends in damage must still end
MIN_GROUP = 3  # a single mask or thumbnail beside the frames is no kind of its own
FOLDER_FPS = 30.0  # of an image folder whose camera.json, if any, gives no fps; times are then nominal


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
        self.images, left_out = _images_of(path) if self.is_folder else ([], "")
        if left_out:
            self._note(left_out)
        if self.is_folder and not self.images:
            raise HaustraError(f"the folder {path} holds no images")
        if not self.is_folder and path.stat().st_size == 0:
            raise HaustraError(f"the file {path} is empty")
        self.announced = len(self.images) if self.is_folder else _announced_frames(path)

    def __iter__(self) -> Iterator[RawFrame]:
        return self._read_folder() if self.is_folder else self._read_video()

    def _read_folder(self) -> Iterator[RawFrame]:
        size, fps = None, _folder_fps(self.path)
        for index, path in enumerate(self.images):
            image = cv2.imread(str(path), cv2.IMREAD_COLOR)
            if image is None:
                self._note(f"{path.name} is not a readable image and was skipped")
                continue
            size = size or image.shape
            if image.shape != size:
                raise HaustraError(f"{path.name} has another size than the images before it in {path.parent}")
            yield RawFrame(index, index / fps, np.ascontiguousarray(image[..., ::-1]))

    def _read_video(self) -> Iterator[RawFrame]:
        count = 0
        with open_video(self.path) as container:
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            rate = float(stream.average_rate or 30)
            aspect = stream.sample_aspect_ratio or Fraction(1)
            for frame in self._decode(container):
                seconds = frame.time if frame.time is not None else count / rate
                yield RawFrame(count, float(seconds), self._upright(frame, aspect))
                count += 1
        if count == 0:
            raise HaustraError(f"no frame of {self.path} can be decoded")
        if count < 0.98 * self.announced:
            self._note(f"the video ends early: {count} of {self.announced} announced frames could be decoded")

    def _decode(self, container: "InputContainer") -> Iterator["VideoFrame"]:
        """Frames of every packet that decodes; damaged packets are counted and passed over."""
        import av

        damaged = 0
        packets = container.demux(container.streams.video[0])
        while True:
            try:
                packet = next(packets)
                yield from packet.decode()
            except StopIteration:
                break
            except av.error.EOFError:
                break
            except av.error.FFmpegError:
                damaged += 1
                if damaged > MAX_DAMAGED:
                    break
        if damaged:
            self._note(f"{damaged} damaged pieces of the video were passed over")

    def _upright(self, frame: "VideoFrame", aspect: Fraction) -> NDArray[np.uint8]:
        """Pixels (H,W,3) as they are to be looked at: square, and turned upright."""
        if frame.interlaced_frame:
            self._note("the video is interlaced: its fields are not taken apart, which blurs what moves")
        rgb = frame.to_ndarray(format="rgb24")
        if aspect != 1:
            self._note(f"pixels are not square ({aspect}): frames were stretched to make them so")
            rgb = cv2.resize(rgb, (round(rgb.shape[1] * float(aspect)), rgb.shape[0]), interpolation=cv2.INTER_AREA)
        # FFmpeg's rotation is the counter-clockwise turn that makes the picture upright.
        return np.ascontiguousarray(np.rot90(rgb, frame.rotation // 90))

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


def _images_of(folder: Path) -> tuple[list[Path], str]:
    """The frames of an image folder, or of the `rgb/` of an RGB-D folder, in natural order; and what was left out.

    Data sets mix colour frames with depth, normals and masks of the same size (SimCol3D, C3VD). Names are grouped by
    what is left without their numbers; of several groups the one that says colour is taken, and none is guessed.
    """
    inner = folder / "rgb" if (folder / "rgb").is_dir() else folder
    groups: dict[str, list[Path]] = {}
    count = 0
    for path in inner.iterdir():
        if path.suffix.lower() in IMAGE_SUFFIXES:
            count += 1
            groups.setdefault(re.sub(r"\d+", "#", path.stem).lower(), []).append(path)
    if max(map(len, groups.values()), default=0) >= MIN_GROUP:
        groups = {name: paths for name, paths in groups.items() if len(paths) >= MIN_GROUP}
    named = {name for name in groups if any(word in name for word in ("color", "colour", "rgb", "framebuffer"))}
    if len(groups) > 1 and len(named) != 1:
        raise HaustraError(f"{inner} holds several kinds of images ({', '.join(sorted(groups))}); give one in a folder")
    chosen = named.pop() if len(groups) > 1 else next(iter(groups), "")
    left_out = count - len(groups.get(chosen, []))
    note = f"{left_out} images of other kinds in {inner.name} were left out" if left_out else ""
    return sorted(groups.get(chosen, []), key=_natural), note


def _natural(path: Path) -> list[tuple[int, str]]:
    """Numbers by value: 2 before 10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.stem)]


def _folder_fps(folder: Path) -> float:
    """Frames a second of an RGB-D folder; `FOLDER_FPS` where it does not say."""
    try:
        return float(json.loads((folder / "camera.json").read_text())["fps"])
    except (OSError, ValueError, KeyError, TypeError):
        return FOLDER_FPS
