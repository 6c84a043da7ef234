"""Frames out of a video file, an image folder or an RGB-D folder: index, time in seconds, RGB pixels."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera
from haustra.core.errors import HaustraError
from haustra.core.text import check_name
from pipeline.input.decoding import decoded, film_stream, how_it_ends, open_video
from pipeline.input.dicom_video import is_dicom, read_dicom_video
from pipeline.input.display import Clock, RgbConverter, display_matrix, in_size, square_and_upright, upper_field
from pipeline.input.film_faults import WHOLE_ROWS, FilmFaults, look_at, row_change
from pipeline.input.image_folder import (
    bits_of,
    folder_fps,
    images_of,
    in_8_bits,
    read_picture,
    refuse_stack,
    what_else_is_in,
)
from pipeline.run_folder.earlier_run import RECORD_NAME

if TYPE_CHECKING:
    from av import VideoFrame
    from av.codec.context import CodecContext

SMALLEST = 32  # px of a picture's side that is looked at for faults
MOST_ASPECT = 4  # width over height of a pixel, or the other way round: DV's widest is 1.46
# FFmpeg's names of formats that store a frame rate at most, and no times: what it derives runs backwards, or is none.
NO_TIMES = ("h264", "hevc", "mjpeg")
PALETTES = ("gif", "apng")
BY_PACKET = ("avi",)  # as those, but each packet has its place in the film, lost ones too


@dataclass(frozen=True)
class RawFrame:
    """One decoded frame: its index in the source, time in seconds, (H,W,3) uint8 RGB."""

    index: int
    seconds: float
    rgb: NDArray[np.uint8]


class Source:
    """A video or folder that can be read from its beginning as often as needed.

    Attributes: path; announced (number of frames that the source claims, 0 = unknown); notes (sentences about what
    was amiss while reading, filled by iteration); step_s (a film's nominal interval between frames, s; 0 before it is
    read, and of a folder).
    """

    def __init__(self, path: Path) -> None:
        if not path.exists():
            raise HaustraError(f"there is no file or folder {path}")
        check_name(path)
        self.path = path
        self.notes: list[str] = []
        self.is_folder = path.is_dir()
        if self.is_folder and (path / RECORD_NAME).is_file():
            raise HaustraError(f"{path} is a run folder; give the film that it was made of")
        self.images, left_out = images_of(path) if self.is_folder else ([], "")
        if left_out:
            self._note(left_out)
        if self.is_folder and not self.images:
            raise HaustraError(f"the folder {path} holds no images that are read; {what_else_is_in(path)}")
        refuse_stack(self.images[0] if self.is_folder else path)
        if not self.is_folder and path.stat().st_size == 0:
            raise HaustraError(f"the file {path} is empty")
        self.announced, self.step_s = len(self.images), 0.0
        self._rate = 0.0  # frames/s that a DICOM file says
        self.rows_are_eyes = False  # of a row-interleaved stereo film, which looks like an interlaced one
        self._faults: FilmFaults | None = None
        if not self.is_folder:
            self._rate = read_dicom_video(path).rate if is_dicom(path) else 0.0
            self._stream, streams, self.announced = film_stream(path)
            if streams > 1:
                self._note(f"of {streams} video streams number {self._stream} was taken, the largest that moves")

    @property
    def camera(self) -> Camera | None:
        """Camera of the frames, where the source knows it; a stereo source does once a frame was read."""
        return None

    @property
    def depth_error_per_mm(self) -> float:
        """Error of `depth_mm`: standard deviation over the depth's square, 1/mm."""
        return 0.0

    def check(self) -> None:
        """Raise `HaustraError` for pictures that cannot be what they are said to be."""

    def depth_mm(self) -> NDArray[np.float64] | None:
        """(h,w) z-depth of the frame given last, 0 = none; None where the source measures none."""
        return None

    def __iter__(self) -> Iterator[RawFrame]:
        return self._read_folder() if self.is_folder else self._read_video()

    def _read_folder(self) -> Iterator[RawFrame]:
        size, fps, bits = None, folder_fps(self.path), 0
        unread: list[str] = []
        for index, path in enumerate(self.images):
            image = read_picture(path)
            if image is None:
                unread.append(path.name)
                continue
            size = size or image.shape
            if image.shape != size:
                own, first = (f"{shape[1]}x{shape[0]} px" for shape in (image.shape, size))
                raise HaustraError(
                    f"{path.name} has {own}, but the images before it in {self.path} have {first}: give a folder of "
                    "images of one size; where several are of each, a folder for each size"
                )
            if image.dtype != np.uint8:
                bits = bits or bits_of(self.images)
                self._note(f"the pictures hold values of {bits} bits: they were brought to 8")
                if int(image.max()) >> bits:
                    self._note(f"some pictures hold values of more than {bits} bits, which were cut")
            yield RawFrame(index, index / fps, in_8_bits(image, bits))
        which = f"{len(unread)} of {len(self.images)} images, {unread[0]} the first," if unread else ""
        if size is None:
            raise HaustraError(f"{which} are no pictures of 8 or 16 bits, or damaged: {self.path} has no frame")
        if unread:
            self._note(f"{which} are no pictures of 8 or 16 bits, or damaged, and were skipped")

    def _read_video(self) -> Iterator[RawFrame]:
        count, left_out, size = 0, 0, (0, 0)
        if self._faults is None:
            self._faults = self._find_faults()
        with open_video(self.path) as container:
            stream = container.streams.video[self._stream]
            stream.thread_type = "AUTO"
            has_times = container.format.name not in NO_TIMES
            # Of a bare stream the average is FFmpeg's default; what the stream itself says is in its headers.
            rate = float((stream.average_rate if has_times else stream.guessed_rate) or 30)
            clock = Clock(self._rate or rate, has_times and not self._rate)
            self.step_s = clock.step
            aspect = stream.sample_aspect_ratio or Fraction(1)
            to_rgb = RgbConverter()
            for frame in decoded(container, stream, self._note):
                if frame is None:
                    left_out += 1
                    if not clock.has_times or count == 0:  # the first stamp does not tell of them
                        clock.seconds(None)
                    continue
                rgb = self._upright(frame, to_rgb(frame), aspect)
                size = size if count else (rgb.shape[1], rgb.shape[0])
                stamp: float | None = frame.time
                if container.format.name in BY_PACKET:
                    stamp = None if frame.dts is None else float(frame.dts * (stream.time_base or 1 / rate))
                index = count + left_out
                yield RawFrame(index, clock.seconds(stamp), self._of_size(rgb, size, index, aspect))
                count += 1
            for sentence in clock.notes:
                self._note(sentence)
            ending = how_it_ends(self.path, container, count, self.announced, clock) if count else ""
        if count == 0:
            raise HaustraError(f"no frame of {self.path} can be decoded; save it as MP4, or as a folder of PNG images")
        if ending:
            self._note(ending)

    def _find_faults(self) -> FilmFaults:
        """What the beginning of the film shows, which no file says."""
        with open_video(self.path) as container:
            stream = container.streams.video[self._stream]
            stream.thread_type = "AUTO"
            to_rgb = RgbConverter()
            faults = look_at(
                self._of_one_time(frame, to_rgb(frame))
                for frame in decoded(container, stream, self._note)
                if frame is not None and min(frame.width, frame.height) >= SMALLEST
            )
            codec: CodecContext | None = stream.codec_context  # PyAV has none where FFmpeg has no decoder
            if codec is not None and codec.name in PALETTES:  # whose dither alternates from row to row
                faults = replace(faults, combed=False)
        for sentence in faults.notes:
            self._note(sentence)
        return faults

    def _of_one_time(self, frame: "VideoFrame", rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Pixels (H,W,3) as stored; of an interlaced frame, and of two eyes in alternate rows, the upper rows."""
        return upper_field(rgb) if frame.interlaced_frame or self.rows_are_eyes else rgb

    def _of_size(
        self, rgb: NDArray[np.uint8], size: tuple[int, int], index: int, aspect: Fraction = Fraction(1)
    ) -> NDArray[np.uint8]:
        """A frame in the size (width, height) of the film's first one; HaustraError where its shape is another."""
        sized = in_size(rgb, size)
        if sized is rgb:
            return rgb
        change = f"from {size[0]}x{size[1]} to {rgb.shape[1]}x{rgb.shape[0]} px"
        if sized is None:
            change += f" (if its pixels are {aspect} all along)" if aspect != 1 else ""
            raise HaustraError(
                f"the film's picture changes {change} at frame {index}: cut it there, and reconstruct the parts"
            )
        self._note(f"the film's size changes {change}: such frames were brought to the first size, as of the same lens")
        return sized

    def _upright(self, frame: "VideoFrame", rgb: NDArray[np.uint8], aspect: Fraction) -> NDArray[np.uint8]:
        """A frame's pixels (H,W,3) as they are to be looked at: square, and turned upright."""
        flagged = frame.interlaced_frame and not self.rows_are_eyes
        if flagged:
            self._note("the video is interlaced: of each frame the upper field was taken, at half the height's detail")
        if flagged or (self._faults is not None and self._faults.combed and row_change(rgb) > WHOLE_ROWS):
            rgb = upper_field(rgb)
        if not 1 / MOST_ASPECT <= aspect <= MOST_ASPECT:
            self._note(f"pixels are said to be {aspect} times as wide as high, which none are: taken for square")
            aspect = Fraction(1)
        if aspect != 1:
            self._note(f"pixels are not square ({aspect}): frames were stretched to make them so")
        return square_and_upright(rgb, aspect, display_matrix(frame))

    def _note(self, sentence: str) -> None:
        if sentence not in self.notes:
            self.notes.append(sentence)
