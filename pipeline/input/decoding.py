"""Packets and frames of a video file as FFmpeg reads it, damage and all: what cannot be read is counted, not fatal."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from haustra.core.errors import HaustraError
from haustra.core.text import counted
from pipeline.input.dicom_video import is_dicom, read_dicom_video

if TYPE_CHECKING:
    from av import Packet, VideoFrame
    from av.container import InputContainer
    from av.video.stream import VideoStream

STILLS = 0.1  # of another stream's number of pictures: one with fewer is a cover, or slides
MAX_DAMAGED = 10_000  # packets; a stream that never ends in damage must still end
MOST_SMEARED = 300  # frames after a damaged one that are left out where no keyframe of the codec comes
SENT = ("mpegts", "mpeg")  # FFmpeg's names of formats that are sent, and say nowhere how long they are
LEAST_READ = 0.98  # share of such a file that packets must come from


def open_video(path: Path) -> "InputContainer":
    """An open PyAV container with a video stream; one sentence if there is none."""
    import av

    film = read_dicom_video(path) if is_dicom(path) else None
    # "10:30.mp4" alone would be read as the address of a protocol.
    file, kind = (str(path.absolute()), None) if film is None else (film.stream, film.kind)
    try:
        container = av.open(file, "r", format=kind)
    except (av.error.FFmpegError, ValueError, OSError) as error:
        raise HaustraError(f"{path} is not a video that FFmpeg can read (or its index is cut off)") from error
    if not container.streams.video:
        container.close()
        raise HaustraError(f"{path} holds no video stream")
    return container


def packets_of(container: "InputContainer", streams: Any) -> Iterator["Packet | None"]:
    """Packets of one stream or several; None for each piece of the file that cannot be read."""
    import av

    for _ in range(MAX_DAMAGED + 1):
        try:
            yield from container.demux(streams)
            return
        except av.error.EOFError:
            return
        except (av.error.FFmpegError, IndexError):  # IndexError: of a stream that was not there at the beginning
            yield None


def decoded(container: "InputContainer", stream: "VideoStream", note: Callable[[str], None]) -> Iterator["VideoFrame"]:
    """Frames of every packet that decodes. Damaged packets are passed over. Of a stream that was sent, a frame that the
    decoder calls corrupt, since part of it was lost, and those that are decoded from it, up to the codec's next
    keyframe, are left out: they are smeared. Of a file of another kind, where single bytes are wrong, they are given.
    `note` is told how many of each."""
    import av

    damaged, smeared, doubtful, is_sent = 0, False, 0, container.format.name in SENT
    for packet in packets_of(container, stream):
        try:
            for frame in () if packet is None else packet.decode():
                smeared = frame.is_corrupt or (smeared and not frame.key_frame and doubtful < MOST_SMEARED)
                doubtful += smeared
                if not (smeared and is_sent):
                    yield frame
            damaged += packet is None
        except av.error.EOFError:
            break
        except av.error.FFmpegError:
            damaged += 1
        if damaged > MAX_DAMAGED:
            break
    if damaged:
        note(f"{damaged} damaged pieces of the video were passed over")
    if doubtful:
        which = f"{counted(doubtful, 'frame')} of damaged pieces of the video or decoded from such"
        note(f"left out: {which}" if is_sent else f"may be wrong in places: {which}")


def unread_share(container: "InputContainer", path: Path) -> float:
    """Share of the end of a file of a `SENT` format that no packet comes from; 0 where that is little."""
    if container.format.name not in SENT:
        return 0.0
    with open_video(path) as again:
        ends = [packet.pos + packet.size for packet in packets_of(again, list(again.streams)) if packet and packet.pos]
    read = max(ends, default=0) / path.stat().st_size
    return 0.0 if read >= LEAST_READ else 1 - read


def film_stream(path: Path) -> tuple[int, int, int]:
    """Number, among a file's video streams, of the film: the largest picture of those that move, first in the file of
    equal ones; how many streams there are; and how many frames that one claims."""
    with open_video(path) as container:
        streams = list(container.streams.video)
        number = 0
        if len(streams) > 1:
            pictures = dict.fromkeys((stream.index for stream in streams), 0)
            for packet in packets_of(container, streams):
                if packet is not None:
                    pictures[packet.stream.index] += packet.size > 0
            most = max(pictures.values())
            moving = [place for place, one in enumerate(streams) if pictures[one.index] >= STILLS * most]
            number = max(moving, key=lambda place: (streams[place].width * streams[place].height, -place))
        return number, len(streams), _claimed_frames(container, streams[number])


def claimed_seconds(container: "InputContainer") -> float:
    """Length that a Matroska file announces, which counts no frames; 0 of others, whose length FFmpeg infers."""
    return (container.duration or 0) / 1e6 if "matroska" in container.format.name else 0.0


def _claimed_frames(container: "InputContainer", stream: "VideoStream") -> int:
    """Frames that a file announces, 0 where it does not; of MP4 no more than its edit list leaves of them."""
    if "mp4" not in container.format.name or not (stream.duration and stream.time_base and stream.average_rate):
        return stream.frames
    return min(stream.frames, round(stream.duration * stream.time_base * stream.average_rate))
