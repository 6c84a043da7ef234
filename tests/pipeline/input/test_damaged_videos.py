"""Damaged films: what is decoded from what was lost is left out, the rest keeps its place, and a sentence says so."""

from __future__ import annotations

import contextlib
from pathlib import Path

import av
import numpy as np
import pytest

from haustra.core.errors import HaustraError
from pipeline.input.video import Source
from tests.helpers.videos import textured_frames, without_packets, write_video


def with_packets_of_noise(path: Path, lost: list[int]) -> None:
    """Packets of these numbers, in decoding order, overwritten."""
    data, rng = bytearray(path.read_bytes()), np.random.default_rng(0)
    with av.open(str(path)) as film:
        packets = [bytes(packet) for packet in film.demux(video=0) if packet.size]
    for packet in (packets[k] for k in lost):
        place = data.index(packet)
        data[place : place + len(packet)] = rng.integers(256, size=len(packet), dtype=np.uint8).tobytes()
    path.write_bytes(bytes(data))


@pytest.mark.parametrize("suffix", ["ts", "mkv", "avi"])
@pytest.mark.parametrize("seed", range(4))
def test_two_streams_that_are_damaged_end_in_frames_or_a_sentence(tmp_path: Path, suffix: str, seed: int) -> None:
    path, rng = tmp_path / f"film.{suffix}", np.random.default_rng(seed)
    with av.open(str(path), "w") as file:
        streams = [file.add_stream("mpeg4", rate=25) for _ in range(2)]
        for stream in streams:
            stream.width = stream.height = 96
            stream.pix_fmt = "yuv420p"
        for shade in range(20):
            for stream in streams:
                picture = np.full((96, 96, 3), 9 * shade, np.uint8)
                file.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        for stream in streams:
            file.mux(stream.encode())
    data = bytearray(path.read_bytes())
    for place in rng.integers(len(data) // 10, len(data), 40):
        data[place] = rng.integers(256)
    path.write_bytes(bytes(data))
    with contextlib.suppress(HaustraError):
        assert len(list(Source(path))) <= 21


def test_what_is_decoded_from_a_damaged_frame_is_left_out(tmp_path: Path) -> None:
    """Of a transport stream FFmpeg gives smeared pictures up to the next keyframe, without an error."""
    frames = textured_frames(60)
    path = write_video(tmp_path / "film.ts", frames, g="20", bf="0", sc_threshold="0")
    data = bytearray(path.read_bytes())
    rng, size = np.random.default_rng(0), len(data)
    begin, end = size * 4 // 10, size * 5 // 10
    data[begin:end] = rng.integers(256, size=end - begin, dtype=np.uint8).tobytes()
    path.write_bytes(bytes(data))
    source = Source(path)
    read = list(source)
    assert 20 < len(read) < 60
    for frame in read:
        assert np.abs(frame.rgb.astype(int) - frames[round(30 * (frame.seconds - read[0].seconds))]).mean() < 6
    assert any("damaged pieces of the video or decoded from such" in note for note in source.notes)


@pytest.mark.parametrize("lost", [[25], [25, 26, 27], [10, 45]])
def test_what_follows_lost_packets_is_left_out(tmp_path: Path, lost: list[int]) -> None:
    """Of a frame that is gone as a whole FFmpeg says nothing: the counters of the stream's packets do."""
    frames = textured_frames(80)
    path = write_video(tmp_path / "film.ts", frames, g="20", bf="0", sc_threshold="0")
    source = Source(without_packets(path, lost))
    read = list(source)
    assert 80 - 20 * len(lost) <= len(read) < 80
    for frame in read:
        assert np.abs(frame.rgb.astype(int) - frames[round(30 * frame.seconds)]).mean() < 6
    assert any("left out" in note for note in source.notes)


def test_a_transport_stream_whose_end_is_noise_says_so(tmp_path: Path) -> None:
    path = write_video(tmp_path / "film.ts", textured_frames(60), g="20")
    data = bytearray(path.read_bytes())
    begin = len(data) * 6 // 10
    data[begin:] = np.random.default_rng(0).integers(256, size=len(data) - begin, dtype=np.uint8).tobytes()
    path.write_bytes(bytes(data))
    source = Source(path)
    assert 20 < len(list(source)) < 45
    assert any("nothing could be read of the last 4" in note or "of the last 39" in note for note in source.notes)


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "avi"])
@pytest.mark.parametrize("reordered", ["0", "2"])
@pytest.mark.parametrize("lost", [[27], [27, 28, 29], [24, 66], [39, 40]])
def test_what_follows_a_packet_that_does_not_decode_is_left_out_of_any_film(
    tmp_path: Path, suffix: str, reordered: str, lost: list[int]
) -> None:
    """Such frames were off by 17 grey levels, and tracked as if nothing had been. Those that are shown before the lost
    one, but decoded from it, are smeared as much. After a lost keyframe FFmpeg passes over others without an error."""
    frames = textured_frames(80)
    path = write_video(tmp_path / f"film.{suffix}", frames, g="20", bf=reordered, sc_threshold="0")
    with_packets_of_noise(path, lost)
    source = Source(path)
    read = list(source)
    assert 80 - 20 * len({k // 20 for k in lost}) <= len(read) < 80 - len(lost)
    assert [frame.index for frame in read] == [round(30 * frame.seconds) for frame in read]  # as poses and depth count
    for frame in read:
        assert np.abs(frame.rgb.astype(int) - frames[round(30 * frame.seconds)]).mean() < 6
    assert any("left out" in note for note in source.notes)


@pytest.mark.parametrize("suffix", ["mp4", "mkv"])
@pytest.mark.parametrize("reordered", ["0", "2"])
@pytest.mark.parametrize("lost", [[0], [0, 1], [1]])
def test_a_film_whose_first_packets_do_not_decode_keeps_numbers_and_times(
    tmp_path: Path, suffix: str, reordered: str, lost: list[int]
) -> None:
    """Its first frame was number 1 at 0 s, though it is the twenty-first."""
    frames = textured_frames(60)
    path = write_video(tmp_path / f"film.{suffix}", frames, g="20", bf=reordered, sc_threshold="0")
    with_packets_of_noise(path, lost)
    source = Source(path)
    read = list(source)
    assert [frame.index for frame in read] == [round(30 * frame.seconds) for frame in read]
    for frame in read:
        assert np.abs(frame.rgb.astype(int) - frames[frame.index]).mean() < 6
    assert any("left out" in note for note in source.notes)
