"""Frames of a camera, of a network stream or of a growing file, recorded packet by packet as they come."""

import re
import sys
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, closing
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import HaustraError
from pipeline.input.display import Clock, RgbConverter, display_matrix, in_size, square_and_upright, upper_field
from pipeline.input.video import RawFrame
from pipeline.live.capture.growing_file import GrowingFile
from pipeline.live.capture.pace import Pace

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import InputContainer, OutputContainer

CAMERA_FORMATS = {"linux": "v4l2", "darwin": "avfoundation", "win32": "dshow"}  # FFmpeg's
OPEN_S, READ_S = 15.0, 10.0  # until a source answers, and between two packets
DEFAULT_RATE = 30.0  # frames/s, of a source that says none
RAW_RATE = 12_000_000  # bit/s of what is encoded here, since the camera gives pictures without compression
GROWING_FORMATS = "; a film can be read while it grows in MPEG-TS, Matroska or fragmented MP4, not in plain MP4"
MOST_DAMAGED = 300  # packets in a row
MOST_WAITING = 1000  # packets before the first picture, the latest ones: 40 s at 25 a second


def device_of(name: str) -> str | None:
    """Device of a camera that is given by its number or path; None for anything else."""
    if name.isdecimal():
        return f"/dev/video{name}" if sys.platform == "linux" else name
    return name if name.startswith("/dev/") else None


def without_password(address: str) -> str:
    """An address as it may be shown: without what stands before the last @, and without its query."""
    scheme, mark, rest = address.partition("://")
    return scheme + mark + re.split("[?&]", rest.rpartition("@")[2])[0] if mark else address


class Stream:
    """A source that does not wait.

    address: in FFmpeg's words; `name` is the same without a password, for people and files. recording: the file to
    write, or the growing file itself. device: of a camera, in FFmpeg's words.
    """

    def __init__(self, address: str, recording: Path, device: str | None = None, grows: bool = False) -> None:
        self.name, self.recording, self.device, self.grows = without_password(address), recording, device, grows
        self._address = address
        if device is not None and sys.platform == "linux" and not Path(device).exists():
            raise HaustraError(f"there is no camera {device}")

    def frames(self, stopped: threading.Event) -> Iterator[RawFrame]:
        import av

        with ExitStack() as stack:
            container = self._open(stopped, stack)
            if not container.streams.video:
                raise HaustraError(f"{self.name} holds no video")
            film = container.streams.video[0]
            film.thread_type = "SLICE"  # frame threads hold frames back
            record = None if self.grows else stack.enter_context(_Recorder(self.recording, film))
            clock = Clock(float(film.average_rate or film.guessed_rate or DEFAULT_RATE))
            size: tuple[int, int] | None = None
            index, damaged, pace = 0, 0, Pace()  # a file is written in gushes
            to_rgb = RgbConverter()
            try:
                for packet in container.demux(film):
                    if stopped.is_set():
                        return
                    try:
                        frames = packet.decode()
                        damaged = 0
                    except av.error.InvalidDataError:
                        frames, damaged = [], damaged + 1
                        if damaged > MOST_DAMAGED:
                            raise
                    if record is not None:
                        record.write(packet, frames)
                    for frame in frames:
                        shown = _as_shown(frame, to_rgb(frame), film.sample_aspect_ratio or Fraction(1))
                        size = size or (shown.shape[1], shown.shape[0])
                        rgb = self._of_size(shown, size)
                        seconds = clock.seconds(frame.time)
                        if self.grows and pace.is_stopped_before(seconds, stopped):
                            return
                        yield RawFrame(index, seconds, rgb)
                        index += 1
            except av.error.FFmpegError as error:
                if stopped.is_set():
                    return
                if index == 0 and self.grows:
                    raise HaustraError(f"{self.name} cannot be read: {_reason(error)}{GROWING_FORMATS}") from error
                raise HaustraError(f"the source {self.name} was lost after {index} frames: {_reason(error)}") from error

    def _of_size(self, rgb: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
        """A picture in the size (width, height) of the first one; HaustraError where its shape is another."""
        sized = in_size(rgb, size)
        if sized is None:
            height, width = rgb.shape[:2]
            raise HaustraError(
                f"the picture of {self.name} changed from {size[0]}x{size[1]} to {width}x{height} px: begin anew"
            )
        return sized

    def _open(self, stopped: threading.Event, stack: ExitStack) -> "InputContainer":
        import av

        what: Any = self.device or self._address
        options, kind = {}, None
        if self.device is not None:
            import av.device

            kind, options = CAMERA_FORMATS.get(sys.platform), {"input_format": "mjpeg"}
        if self._address.startswith("rtsp"):
            options = {"rtsp_transport": "tcp"}
        if self.grows:
            what = stack.enter_context(closing(GrowingFile(self.recording, stopped)))
        try:
            try:
                return stack.enter_context(av.open(what, "r", kind, options, timeout=(OPEN_S, READ_S)))
            except av.error.FFmpegError:
                if self.device is None:
                    raise  # a camera may have pictures without compression alone
                return stack.enter_context(av.open(what, "r", kind, timeout=(OPEN_S, READ_S)))
        except (av.error.FFmpegError, ValueError, OSError) as error:
            hint = GROWING_FORMATS if self.grows else ""
            raise HaustraError(f"the source {self.name} cannot be opened: {_reason(error)}{hint}") from error


class _Recorder:
    """Writes packets as they came, from the first one on; pictures without compression are encoded first. Nothing is
    written before a packet gave a picture: a source that gives none must not replace an earlier recording.

    Stamps go on where the source's run backwards or are missing, as in the times of its frames.
    """

    def __init__(self, path: Path, film: Any) -> None:
        self.path, self._film = path, film
        self._raw = film.codec_context.name == "rawvideo"
        self._file: OutputContainer | None = None
        self._stream: Any = None
        rate = film.average_rate or film.guessed_rate or round(DEFAULT_RATE)
        self._step = max(1, round(1 / (rate * film.time_base)))
        self._last, self._shift = -self._step, 0
        self._waiting: deque[Any] = deque(maxlen=MOST_WAITING)  # packets before the first picture

    def write(self, packet: Any, frames: list[Any]) -> None:
        """HaustraError where the disk takes no more; what was written stays readable."""
        import av

        try:
            if self._raw:
                for frame in frames:
                    self._opened().mux(self._stream.encode(frame))
                return
            if packet.size:
                self._waiting.append(packet)
            while self._waiting and (frames or self._file is not None):
                self._mux(self._waiting.popleft())
        except (OSError, av.error.FFmpegError) as error:
            raise HaustraError(
                f"the recording {self.path} cannot be written any more ({_reason(error)}); what it holds is kept"
            ) from error

    def _mux(self, packet: Any) -> None:
        dts = self._last + self._step if packet.dts is None else packet.dts + self._shift
        if dts <= self._last:
            self._shift += self._last + self._step - dts
            dts = self._last + self._step
        ahead = 0 if packet.pts is None or packet.dts is None else packet.pts - packet.dts
        packet.dts, packet.pts, self._last = dts, dts + ahead, dts
        file = self._opened()
        packet.stream = self._stream
        file.mux(packet)

    def _opened(self) -> "OutputContainer":
        """The file, made when it is first written to."""
        if self._file is None:
            import av

            # A process that is killed loses no more than half a second.
            flushed = {"flush_packets": "1", "cluster_time_limit": "500"}
            self._file = av.open(str(self.path), "w", "matroska", options=flushed)
            if self._raw:
                codec = self._film.codec_context
                self._stream = self._file.add_stream("mpeg4", rate=self._film.average_rate or round(DEFAULT_RATE))
                self._stream.width, self._stream.height = codec.width, codec.height
                self._stream.pix_fmt, self._stream.bit_rate = "yuv420p", RAW_RATE
            else:
                self._stream = self._file.add_stream_from_template(self._film)
        return self._file

    def __enter__(self) -> "_Recorder":
        return self

    def __exit__(self, *_: object) -> None:
        import av

        if self._file is None:
            return
        try:
            if self._raw:
                self._file.mux(self._stream.encode(None))
            self._file.close()
        except (OSError, av.error.FFmpegError):  # a full disk was told of already; Matroska needs no end
            pass


def _as_shown(frame: "VideoFrame", rgb: NDArray[np.uint8], aspect: Fraction) -> NDArray[np.uint8]:
    """A frame's pixels (H,W,3) as they are to be looked at; of an interlaced frame the upper field alone."""
    rgb = upper_field(rgb) if frame.interlaced_frame else rgb
    return square_and_upright(rgb, aspect, display_matrix(frame))


def _reason(error: Exception) -> str:
    import av

    if isinstance(error, av.error.ExitError):  # how PyAV says that the time given is over
        return "it gave nothing in time"
    return getattr(error, "strerror", None) or str(error) or type(error).__name__
