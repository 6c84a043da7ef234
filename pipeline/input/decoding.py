"""Packets and frames of a video file as FFmpeg reads it, damage and all: what cannot be read is counted, not fatal."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from haustra.core.errors import HaustraError
from haustra.core.text import counted
from pipeline.input.containers.named_length import is_cut_off, named_seconds
from pipeline.input.dicom_video import is_dicom, read_dicom_video
from pipeline.input.display import Clock

if TYPE_CHECKING:
    from av import Packet, VideoFrame
    from av.container import InputContainer
    from av.video.stream import VideoStream

STILLS = 0.1  # of another stream's number of pictures: one with fewer is a cover, or slides
MAX_DAMAGED = 10_000  # packets; a stream that never ends in damage must still end
MOST_SMEARED = 300  # frames after a loss that are left out where no keyframe of the codec comes
LEAST_DECODED = 0.98  # share of the frames that a file counts
FEWEST_MISSING = 2  # frames: a part that was cut out may end within one, and a header round its length
MOST_SHORT = 0.05  # share of the length that a header names
FLAGS_REACH = 5  # packets after a flagged one in which the gap is
LONGEST_STEP = 1.5  # of decoding times, in durations of a packet: more, and one is missing
SENT = ("mpegts", "mpeg")  # FFmpeg's names of formats that are sent, and say nowhere how long they are
LEAST_READ = 0.98  # share of such a file that packets must come from,
MOST_PADDING = 16 << 10  # but for so many bytes: a program stream is filled up to whole packs of about 2 KB


def open_video(path: Path) -> "InputContainer":
    """An open PyAV container with a video stream; one sentence if there is none."""
    import av

    film = read_dicom_video(path) if is_dicom(path) else None
    # "10:30.mp4" alone would be read as the address of a protocol.
    file, kind = (str(path.absolute()), None) if film is None else (film.stream, film.kind)
    try:
        container = av.open(file, "r", format=kind)
    except (av.error.FFmpegError, ValueError, OSError) as error:
        raise HaustraError(
            f"{path} is not a video that FFmpeg can read (or its index is cut off); see whether a player shows it, and "
            "save or copy it anew"
        ) from error
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


def decoded(
    container: "InputContainer", stream: "VideoStream", note: Callable[[str], None]
) -> Iterator["VideoFrame | None"]:
    """Frames of every packet that decodes; None for each that is left out, and for each that does not come after a
    packet that does not decode, so that frames behind a loss keep their numbers.

    What is decoded after a packet that could not be, up to the codec's next keyframe, is left out: it is smeared. Of a
    stream that was sent, so are frames of which a part was lost, and what follows them; of a file of another kind,
    where single bytes are wrong, those are given. `note` is told how many of each, and where the end of a stream that
    was sent cannot be read."""
    import av

    damaged, smeared, doubtful, read_to, is_sent = 0, 0, 0, 0, container.format.name in SENT
    gaps, smear = Gaps(), Smear()
    try:
        for packet in packets_of(container, stream):
            try:
                if is_sent and (since := gaps.before(packet)) is not None:
                    smear.begin(since)
                if packet is not None and packet.pos is not None:
                    read_to = max(read_to, packet.pos + packet.size)
                if packet is not None:
                    smear.await_frame(packet)
                for frame in () if packet is None else packet.decode():
                    is_covered = smear.covers(frame)
                    smeared += smear.missing
                    yield from [None] * smear.missing
                    is_given = not is_covered or not (is_sent or smear.is_of_lost_packet)
                    smeared += not is_given
                    doubtful += is_covered and is_given
                    yield frame if is_given else None
                damaged += packet is None
            except av.error.EOFError:
                break
            except av.error.FFmpegError:
                damaged += 1
                smear.begin_at_lost_packet()
                if packet is None or packet.pts is None:  # else `Smear` counts it as missing
                    yield None
            if damaged > MAX_DAMAGED:
                break
    finally:  # also where nobody asks for the rest
        if damaged:
            were = "was" if damaged == 1 else "were"
            note(f"{counted(damaged, 'damaged piece')} of the video {were} passed over")
        which = "of damaged pieces of the video or decoded from such"
        if smeared:
            note(f"left out: {counted(smeared, 'frame')} {which}")
        if doubtful:
            note(f"may be wrong in places: {counted(doubtful, 'frame')} {which}")
    if is_sent and not _is_whole(read_to, container.size) and (unread := _unread_share(Path(container.name))):
        note(f"the video ends early: nothing could be read of the last {100 * unread:.0f} % of its file")


class Gaps:
    """Where packets of a stream that was sent are missing: FFmpeg flags one of the packets around a break in the
    stream's counters, and times go on farther than one packet. Where whole streams were joined they go back."""

    def __init__(self) -> None:
        self._last: Packet | None = None
        self._since_flag = FLAGS_REACH

    def before(self, packet: "Packet | None") -> float | None:
        """The decoding time from which on frames are missing before a packet; None where none are."""
        if packet is None:
            return -math.inf
        last, self._last = self._last, packet
        self._since_flag = 0 if packet.is_corrupt else self._since_flag + 1
        if last is None or last.dts is None or packet.dts is None or not last.duration:
            return None
        is_gap = packet.dts - last.dts > LONGEST_STEP * last.duration
        return last.dts + 1 if is_gap and self._since_flag < FLAGS_REACH else None


class Smear:
    """From a loss to the codec's next keyframe: what is decoded from lost frames shows smeared pictures.

    is_of_lost_packet: whether the loss is of a packet that could not be decoded at all. missing: of the latest frame,
    how many that should have come before it such a loss took, where it ends the loss; else 0. A decoder passes over
    what follows a lost keyframe without a word, so that they are not as many as packets with an error.
    """

    def __init__(self) -> None:
        self.is_of_lost_packet, self.missing = False, 0
        self._since: float | None = None  # presentation time of the first frame that is lost
        self._count = 0
        self._awaited: set[int] = set()  # presentation times of packets whose frames have not come,
        self._passed: set[int] = set()  # and of those that, since a packet was lost, are behind frames that came
        self._is_passed = True  # whether the frame that a lost packet would have given is behind those that came

    def await_frame(self, packet: "Packet") -> None:
        """A packet that is about to be decoded."""
        if packet.pts is not None and packet.size and not packet.is_discard:  # of which no frame is wanted
            self._awaited.add(packet.pts)

    def begin(self, since: float) -> None:
        """With a presentation time."""
        self._since, self._count = since if self._since is None else min(self._since, since), 0

    def begin_at_lost_packet(self) -> None:
        """A decoder with threads does not say which of the latest packets it gave up: the one whose frame does not
        come. Frames shown before that one, but decoded after it, are smeared too."""
        self.begin(-math.inf)
        self.is_of_lost_packet, self._is_passed = True, False

    def covers(self, frame: "VideoFrame") -> bool:
        """Whether a frame, which the decoder gives some packets later, is of a loss or built on one."""
        pts = math.inf if frame.pts is None else frame.pts
        passed = {awaited for awaited in self._awaited if awaited < pts}
        is_counted = self.is_of_lost_packet and frame.pts is not None
        self._is_passed = self._is_passed or bool(passed) or frame.pts is None
        self._awaited -= passed | {pts}
        self._passed = (self._passed | passed if is_counted else self._passed) - {pts}  # AVI's come in any order
        self.missing = 0
        if frame.is_corrupt:
            self._since, self._count = pts, 0
        if self._since is None or pts < self._since:
            return False
        is_anew = frame.key_frame and not frame.is_corrupt and pts > self._since and self._is_passed
        if self._count >= MOST_SMEARED or is_anew:
            self._since, self.is_of_lost_packet = None, False
            self.missing, self._passed = len(self._passed), set()
            return False
        self._count += 1
        return True


def _unread_share(path: Path) -> float:
    """Share of the end of a file that no packet of any stream comes from; 0 where that is little."""
    with open_video(path) as again:
        ends = [packet.pos + packet.size for packet in packets_of(again, list(again.streams)) if packet and packet.pos]
    read, size = max(ends, default=0), path.stat().st_size
    return 0.0 if _is_whole(read, size) else 1 - read / size


def _is_whole(read: int, size: int) -> bool:
    """Whether of a file of that size packets come from so much that the rest is padding, bytes."""
    return read >= min(LEAST_READ * size, size - MOST_PADDING)


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


def how_it_ends(path: Path, container: "InputContainer", count: int, announced: int, clock: Clock) -> str:
    """A sentence where a film is not all there, by what its file says of its length; empty where it is, or nothing is
    said. count: frames that were decoded. announced: frames that the file claims, 0 = unknown. clock: of the film."""
    missing = announced - count
    if missing >= FEWEST_MISSING and count < LEAST_DECODED * announced:
        ends_early = clock.last < LEAST_DECODED * (announced - 1) * clock.step
        what = "the video ends early" if ends_early else "the video has gaps"
        return f"{what}: {count} of {announced} announced frames could be decoded"
    named_s, least_s = named_seconds(container, path), FEWEST_MISSING * clock.step
    short_s = named_s - max(clock.last, clock.last_stamp) - clock.step
    # The length is that of the longest stream, which may be another one.
    if short_s > max(least_s, MOST_SHORT * named_s) and named_s - _last_seconds(path) > MOST_SHORT * named_s:
        return f"the video ends early: {clock.last + clock.step:.1f} of {named_s:.1f} s could be decoded"
    return "the video ends early: its file is cut off" if is_cut_off(container, path) else ""


def _last_seconds(path: Path) -> float:
    """Where the last packet of any stream ends, by the file's times and from its first, whichever is later, s."""
    first, last = math.inf, 0.0
    with open_video(path) as again:
        for packet in packets_of(again, list(again.streams)):
            if packet is not None and packet.pts is not None and packet.time_base:
                first = min(first, float(packet.pts * packet.time_base))
                last = max(last, float((packet.pts + (packet.duration or 0)) * packet.time_base))
    return last - min(first, 0.0) if last else 0.0


def _claimed_frames(container: "InputContainer", stream: "VideoStream") -> int:
    """Frames that a file announces, 0 where it does not; of MP4 no more than its edit list leaves of them."""
    if "mp4" not in container.format.name or not (stream.duration and stream.time_base and stream.average_rate):
        return stream.frames
    return min(stream.frames, round(stream.duration * stream.time_base * stream.average_rate))
