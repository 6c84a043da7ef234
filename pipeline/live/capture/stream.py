"""Frames of a camera, of a network stream or of a growing file, recorded packet by packet as they come."""

import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from haustra.core.errors import HaustraError
from pipeline.input.display import Clock, as_shown
from pipeline.input.video import RawFrame
from pipeline.live.capture.growing_file import GrowingFile
from pipeline.live.capture.pace import Pace

if TYPE_CHECKING:
    from av.container import InputContainer, OutputContainer

CAMERA_FORMATS = {"linux": "v4l2", "darwin": "avfoundation", "win32": "dshow"}  # FFmpeg's
OPEN_S, READ_S = 15.0, 10.0  # until a source answers, and between two packets
DEFAULT_RATE = 30.0  # frames/s, of a source that says none
RAW_RATE = 12_000_000  # bit/s of what is encoded here, since the camera gives pictures without compression
MOST_DAMAGED = 300  # packets in a row


def device_of(name: str) -> str | None:
    """Device of a camera that is given by its number or path; None for anything else."""
    if name.isdecimal():
        return f"/dev/video{name}" if sys.platform == "linux" else name
    return name if name.startswith("/dev/") else None


def without_password(address: str) -> str:
    """An address as it may be shown: without what stands before the host."""
    scheme, mark, rest = address.partition("://")
    host, slash, path = rest.partition("/")
    return scheme + mark + host.rpartition("@")[2] + slash + path if mark else address


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
            index, damaged, pace = 0, 0, Pace()  # a file is written in gushes
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
                        rgb = as_shown(frame, film.sample_aspect_ratio or Fraction(1), frame.interlaced_frame)
                        seconds = clock.seconds(frame.time)
                        if self.grows and pace.is_stopped_before(seconds, stopped):
                            return
                        yield RawFrame(index, seconds, rgb)
                        index += 1
            except av.error.FFmpegError as error:
                if stopped.is_set():
                    return
                raise HaustraError(f"the source {self.name} was lost after {index} frames: {_reason(error)}") from error

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
            return stack.enter_context(av.open(what, "r", kind, options, timeout=(OPEN_S, READ_S)))
        except (av.error.FFmpegError, ValueError, OSError) as error:
            hint = ""
            if self.grows:
                hint = "; a film can be read while it grows in MPEG-TS, Matroska or fragmented MP4, not in plain MP4"
            raise HaustraError(f"the source {self.name} cannot be opened: {_reason(error)}{hint}") from error


class _Recorder:
    """Writes packets as they came; pictures without compression are encoded first."""

    def __init__(self, path: Path, film: Any) -> None:
        import av

        self.path = path
        self._file: OutputContainer = av.open(str(path), "w", "matroska")
        self._raw = film.codec_context.name == "rawvideo"
        self._stream: Any
        if self._raw:
            self._stream = self._file.add_stream("mpeg4", rate=film.average_rate or round(DEFAULT_RATE))
            self._stream.width, self._stream.height = film.codec_context.width, film.codec_context.height
            self._stream.pix_fmt, self._stream.bit_rate = "yuv420p", RAW_RATE
        else:
            self._stream = self._file.add_stream_from_template(film)

    def write(self, packet: Any, frames: list[Any]) -> None:
        """HaustraError where the disk takes no more; what was written stays readable."""
        try:
            if self._raw:
                for frame in frames:
                    self._file.mux(self._stream.encode(frame))
            elif packet.dts is not None:
                packet.stream = self._stream
                self._file.mux(packet)
        except OSError as error:
            raise HaustraError(
                f"the recording {self.path} cannot be written any more ({_reason(error)}); what it holds is kept"
            ) from error

    def __enter__(self) -> "_Recorder":
        return self

    def __exit__(self, *_: object) -> None:
        try:
            if self._raw:
                self._file.mux(self._stream.encode(None))
            self._file.close()
        except OSError:  # a full disk was told of already; Matroska needs no end
            pass


def _reason(error: Exception) -> str:
    import av

    if isinstance(error, av.error.ExitError):  # how PyAV says that the time given is over
        return "it gave nothing in time"
    return getattr(error, "strerror", None) or str(error) or type(error).__name__
