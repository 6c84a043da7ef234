"""AVI stores no times: frames stay where they belong though they are reordered, lost or damaged on the way."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest

from pipeline.input.video import Source

COUNT, RATE, BITS = 60, 25, 6
CODECS = [("mpeg4", 0), ("mpeg4", 2), ("libx264", 0), ("libx264", 3), ("mjpeg", 0)]


def picture_of(number: int) -> np.ndarray:
    """Its own number in black and white bars."""
    picture = np.full((160, 160, 3), 100, np.uint8)
    for bit in range(BITS):
        picture[20:140, 8 + 24 * bit :][:, :20] = 220 if number >> bit & 1 else 30
    return picture


def number_in(rgb: np.ndarray) -> int:
    return sum(1 << bit for bit in range(BITS) if rgb[60:100, 14 + 24 * bit :][:, :8].mean() > 125)


def write_avi(path: Path, codec: str, reordered: int, lost: tuple[int, ...] = ()) -> Path:
    """A key frame every ten; packets `lost` are recorded as empty ones, as recorders do that cannot keep up."""
    with av.open(str(path), "w", format="avi") as file:
        stream = file.add_stream(codec, rate=RATE)
        stream.width = stream.height = 160
        stream.pix_fmt, stream.bit_rate = ("yuvj420p" if codec == "mjpeg" else "yuv420p"), 2_000_000
        if codec != "mjpeg":
            stream.options = {"bf": str(reordered), "g": "10"}
        frames = [av.VideoFrame.from_ndarray(picture_of(number), format="rgb24") for number in range(COUNT)]
        packets = [packet for frame in [*frames, None] for packet in stream.encode(frame)]
        for place, packet in enumerate(packets):
            if place not in lost:
                file.mux(packet)
    return path


def shifts_of(path: Path) -> tuple[np.ndarray, Source]:
    """Frames by which each picture's time is off the number that it shows; times must increase."""
    source = Source(path)
    frames = list(source)
    seconds = np.array([frame.seconds for frame in frames])
    assert (np.diff(seconds) > 0).all()
    return np.rint(seconds * RATE) - [number_in(frame.rgb) for frame in frames], source


@pytest.mark.parametrize(("codec", "reordered"), CODECS)
def test_a_whole_film_has_each_frame_at_its_time(tmp_path: Path, codec: str, reordered: int) -> None:
    shifts, source = shifts_of(write_avi(tmp_path / "film.avi", codec, reordered))
    assert len(shifts) == COUNT
    assert not shifts.any()
    assert not source.notes


@pytest.mark.parametrize(("codec", "reordered"), CODECS)
def test_after_lost_packets_the_times_are_right_again(tmp_path: Path, codec: str, reordered: int) -> None:
    """Up to the next key frame a decoder may show what is left of the picture before."""
    shifts, source = shifts_of(write_avi(tmp_path / "film.avi", codec, reordered, (20, 21, 33)))
    assert not shifts[:18].any()
    assert not shifts[-15:].any()
    assert any("the video has gaps" in note for note in source.notes)
    assert not any("ends early" in note for note in source.notes)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("codec", "reordered"), CODECS)
def test_damaged_bytes_leave_times_that_increase(tmp_path: Path, codec: str, reordered: int, seed: int) -> None:
    path = write_avi(tmp_path / "film.avi", codec, reordered)
    data, rng = bytearray(path.read_bytes()), np.random.default_rng(seed)
    for place in rng.integers(data.index(b"movi") + 200, data.rindex(b"idx1"), 30):
        data[place] = rng.integers(0, 256)
    path.write_bytes(bytes(data))
    shifts, _ = shifts_of(path)
    assert len(shifts) > COUNT / 2
    assert np.median(np.abs(shifts)) <= 3  # where packets' heads are hit, the demuxer counts anew


def test_a_film_that_is_cut_off_ends_early(tmp_path: Path) -> None:
    whole = write_avi(tmp_path / "film.avi", "mjpeg", 0).read_bytes()
    (tmp_path / "film.avi").write_bytes(whole[: len(whole) // 2])
    shifts, source = shifts_of(tmp_path / "film.avi")
    assert not shifts[:-1].any()  # the last picture is cut in two
    assert any("ends early" in note for note in source.notes)
