"""The length that a file's own header names, and whether a file ends inside one of its pieces.

FFmpeg infers a length where a header names none, by the file's size or its last packet: of a file that is cut off that
says nothing. Here is only what the files say. Both show a film that was cut while it was copied or recorded.
"""

import struct
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

if TYPE_CHECKING:
    from av.container import InputContainer

HEAD = 1 << 16  # bytes in which the headers of FLV, ASF and MXF begin
ASF_FILE_PROPERTIES = bytes.fromhex("a1dcab8c47a9cf118ee400c00c205365")
MXF_PARTITION = bytes.fromhex("060e2b34020501010d0102010102")  # of the header; the byte after it is its status
MXF_COMPLETE = (3, 4)  # statuses: open and closed, with all its values
FIRST_BOXES = (b"ftyp", b"styp", b"moov")
FRAGMENT = (b"moof", b"mdat")
MOST_BOXES, MOST_GIF = 100_000, 1 << 28  # fragments of a day; bytes, which are read at once
GIF_EXTENSION, GIF_IMAGE = 0x21, 0x2C


def named_seconds(container: "InputContainer", path: Path) -> float:
    """Length that the header of a Matroska, FLV, ASF (WMV), MXF or fragmented MP4 file names, s; 0 where none does."""
    kinds, whole = container.format.name, (container.duration or 0) / 1e6
    if "matroska" in kinds:
        return whole
    if "mp4" in kinds:
        return _of_fragments(path)
    with path.open("rb") as file:
        head = file.read(HEAD)
    if kinds == "flv":
        return _of_flv(head)
    if kinds == "asf":
        return _of_asf(head)
    status = head.partition(MXF_PARTITION)[2][:1]
    return whole if kinds == "mxf" and status and status[0] in MXF_COMPLETE else 0.0


def is_cut_off(container: "InputContainer", path: Path) -> bool:
    """Whether a GIF ends inside a picture, or a fragmented MP4 inside a fragment: both count their pictures nowhere."""
    kinds = container.format.name
    if kinds == "gif":
        return path.stat().st_size < MOST_GIF and _gif_ends_inside(path.read_bytes())
    if "mp4" not in kinds:
        return False
    size = path.stat().st_size
    first = last = (b"", 0, 0)
    is_fragmented = False
    with path.open("rb") as file:
        for box in islice(_boxes(file, 0, size), MOST_BOXES):
            first, last = (first if first[0] else box), box
            is_fragmented |= box[0] == b"moof"
    return is_fragmented and first[0] in FIRST_BOXES and last[0] in FRAGMENT and last[2] > size


def _of_flv(head: bytes) -> float:
    """`duration` of onMetaData, a number (AMF type 0); recorders that are stopped leave 0 there."""
    at = head.find(b"duration\x00")
    seconds = struct.unpack(">d", head[at + 9 : at + 17])[0] if at >= 0 and len(head) >= at + 17 else 0.0
    return seconds if 0 < seconds < 1e7 else 0.0


def _of_asf(head: bytes) -> float:
    """Play duration, in 100 ns, less the preroll, in ms; a broadcast's header has none."""
    at = head.find(ASF_FILE_PROPERTIES)
    if at < 0 or len(head) < at + 92:
        return 0.0
    played, _, preroll, flags = struct.unpack("<QQQI", head[at + 64 : at + 92])
    return 0.0 if flags & 1 else max(0.0, played / 1e7 - preroll / 1e3)


def _of_fragments(path: Path) -> float:
    """`mehd` of a fragmented MP4, in the time scale of its `mvhd`."""
    found: dict[bytes, tuple[int, int]] = {}
    with path.open("rb") as file:
        boxes = _boxes(file, 0, path.stat().st_size)
        start, end = next(((start, end) for name, start, end in boxes if name == b"moov"), (0, 0))
        for name, inner, inner_end in list(_boxes(file, start, end)):
            if name == b"mvex":
                found |= {name: (a, b) for name, a, b in _boxes(file, inner, inner_end)}
            found[name] = inner, inner_end
        if not {b"mvhd", b"mehd"} <= found.keys():
            return 0.0
        scale = _field(file, found[b"mvhd"][0], 12, 20, wide=False)
        return _field(file, found[b"mehd"][0], 4, 4) / scale if scale else 0.0


def _field(file: BinaryIO, start: int, at: int, at_1: int, wide: bool = True) -> int:
    """A number of a box at a place that depends on the box's version; of version 1 with 8 bytes where it is `wide`."""
    file.seek(start)
    box = file.read(32)
    is_1 = box[:1] == b"\x01"
    place, width = (at_1 if is_1 else at), (8 if is_1 and wide else 4)
    return int.from_bytes(box[place : place + width], "big")


def _boxes(file: BinaryIO, start: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Name, first byte inside and end of each box of an MP4 from `start` to `end`; a box may claim to end beyond."""
    while start + 8 <= end:
        file.seek(start)
        head = file.read(16)
        size, name, inner = int.from_bytes(head[:4], "big"), head[4:8], start + 8
        if size == 1:
            size, inner = int.from_bytes(head[8:16], "big"), start + 16
        size = size or end - start  # 0: to the end
        if size < inner - start:
            return
        yield name, inner, start + size
        start += size


def _gif_ends_inside(data: bytes) -> bool:
    """Whether the data ends inside a block. One that ends between two blocks is whole, but for the mark of its end."""
    at = 13 + _colours(data, 10)
    while at < len(data):
        if data[at] == GIF_EXTENSION:
            at += 2
        elif data[at] == GIF_IMAGE:
            at += 11 + _colours(data, at + 9)  # and the size of its codes
        else:
            return False  # the mark of its end, or no GIF
        while at < len(data) and data[at]:
            at += 1 + data[at]
        at += 1
        if at > len(data):
            return True
    return False


def _colours(data: bytes, at: int) -> int:
    """Bytes of the table of colours that a block's flags announce."""
    flags = data[at] if at < len(data) else 0
    return 3 << ((flags & 7) + 1) if flags & 0x80 else 0
