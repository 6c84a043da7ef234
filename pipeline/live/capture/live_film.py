"""What a live session looks at: a film played at its own rate, a camera, a stream, or a file that grows."""

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from haustra.core.errors import HaustraError
from pipeline.input.video import RawFrame, Source
from pipeline.live.capture.pace import Pace
from pipeline.live.capture.stream import Stream, device_of, without_password
from pipeline.run_folder.workspace import LIVE_FILM

LEAST_STEP_S = 1e-3  # between two rounds
SCHEMES = ("rtsp", "rtsps", "rtp", "udp", "tcp", "srt", "http", "https")


class LiveFilm(Protocol):
    """name: as the user gave it. recording: the file or folder that holds what was shown, for the run at the end.
    patient: whether frames can wait, since they come from a file that is being played.
    """

    name: str
    recording: Path

    def frames(self, stopped: threading.Event) -> Iterator[RawFrame]:
        """Frames when they are due; ends soon after `stopped` is set. A source that is lost raises `HaustraError`."""


class PlayedFilm:
    """A film or folder of pictures that exists already, at the pace of its time stamps.

    loops: how often it is played; times and numbers of frames go on from round to round.
    """

    def __init__(self, path: Path, loops: int = 1) -> None:
        self.name, self.recording, self.loops = str(path), path, loops
        self.source = Source(path)

    def frames(self, stopped: threading.Event) -> Iterator[RawFrame]:
        pace, index, shift, last = Pace(), 0, 0.0, 0.0
        for _ in range(self.loops):
            step = 0.0
            for frame in self.source:
                seconds = frame.seconds + shift
                if pace.is_stopped_before(seconds, stopped):
                    return
                step, last = seconds - last, seconds
                yield RawFrame(index, seconds, frame.rgb)
                index += 1
            shift = last + max(step, LEAST_STEP_S)


def open_film(name: str, folder: Path, loops: int = 1, grows: bool = False) -> LiveFilm:
    """The source that a name stands for: a file or folder, an address, a camera's number or device.

    folder: of the run, where cameras and streams are recorded. HaustraError for a name that is none of these.
    """
    path, device = Path(name), device_of(name)
    if path.exists() and folder.exists() and path.resolve().is_relative_to(folder.resolve()):
        raise HaustraError(
            f"{name} lies in the output folder {folder}; give another --output, or --resume to finish it"
        )
    if device is not None:
        return Stream(name, folder / LIVE_FILM, device)
    scheme, mark, _ = name.partition("://")
    if mark:
        if scheme.lower() not in SCHEMES:
            raise HaustraError(f"{without_password(name)}: a stream's address begins with one of {', '.join(SCHEMES)}")
        return Stream(name, folder / LIVE_FILM)
    if not path.exists():
        raise HaustraError(
            f"there is no file or folder {name}; a camera is given by its number or device, a stream by its address"
        )
    if grows:
        if not path.is_file():
            raise HaustraError(f"{name} is a folder; --growing is for a film that is still being written")
        return Stream(name, path, grows=True)
    return PlayedFilm(path, loops)
