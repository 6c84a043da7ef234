"""Files that players show rightly: mirrored, joined, with a late clock, a cover, a change of size, 12 bits."""

from __future__ import annotations

import itertools
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from haustra.core.errors import HaustraError
from pipeline.input.display import Clock, upper_field, upright
from pipeline.input.video import Source

SIGNED = [np.diag(signs) for signs in itertools.product((1.0, -1.0), repeat=2)]
MATRICES = SIGNED + [m @ np.array([[0.0, 1.0], [1.0, 0.0]]) for m in SIGNED]


@pytest.mark.parametrize("matrix", MATRICES, ids=lambda m: str(m.astype(int).tolist()))
def test_every_pixel_goes_where_the_display_matrix_sends_it(matrix: np.ndarray) -> None:
    """Oracle: the matrix applied to each pixel's place, and the smallest place brought to the corner."""
    stored = np.arange(3 * 5 * 3, dtype=np.uint8).reshape(3, 5, 3)
    shown = upright(stored, matrix)
    places = np.array([(x, y) for y in range(3) for x in range(5)])
    sent = (places @ matrix.T).astype(int)
    sent -= sent.min(axis=0)
    assert shown.shape[:2] == (sent[:, 1].max() + 1, sent[:, 0].max() + 1)
    for (x, y), (u, v) in zip(places, sent, strict=True):
        np.testing.assert_array_equal(shown[v, u], stored[y, x])


stamps = st.lists(st.one_of(st.none(), st.floats(-1e5, 1e5)), min_size=1, max_size=60)


@given(stamps, st.sampled_from([10.0, 25.0, 29.97, 60.0]), st.booleans())
def test_times_begin_at_zero_and_increase_whatever_the_file_says(given_stamps, rate: float, has_times: bool) -> None:
    clock = Clock(rate, has_times)
    seconds = [clock.seconds(stamp) for stamp in given_stamps]
    assert seconds[0] == 0
    assert (np.diff(seconds) > 0).all()


@given(st.floats(0, 1e5), st.lists(st.floats(0.01, 0.5), min_size=1, max_size=50))
def test_a_clock_that_begins_late_keeps_its_intervals(start: float, steps: list[float]) -> None:
    times = start + np.concatenate([[0], np.cumsum(steps)])
    clock = Clock(30.0)
    np.testing.assert_allclose([clock.seconds(float(t)) for t in times], times - start, atol=1e-6)


@pytest.mark.parametrize("file_says", [[0, 0, 2, 2, 4, 4, 6, 6], [0, 1, 2, 1.5, 4, 5, 6]])
def test_a_repeated_or_early_stamp_moves_no_other_frame(file_says: list[float]) -> None:
    times, clock = np.array(file_says) / 30, Clock(30.0)
    seconds = [clock.seconds(float(time)) for time in times]
    np.testing.assert_allclose(seconds, np.maximum.accumulate(times), atol=0.02 / 30)
    assert not clock.notes


@pytest.mark.parametrize("second", [36_000.0, 3700.0, -36_000.0, -1.0])
def test_a_part_with_another_clock_goes_on_behind_the_first(second: float) -> None:
    clock = Clock(30.0)
    times = np.concatenate([np.arange(20), np.arange(20)]) / 30 + np.repeat([40_000.0, 40_000.0 + second], 20)
    np.testing.assert_allclose([clock.seconds(float(time)) for time in times], np.arange(40) / 30, atol=1e-6)
    assert ("leap over an hour ahead 1 time:" if second > 0 else "run backwards 1 time:") in clock.notes[0]


def test_one_stamp_that_is_damaged_moves_no_other_frame_far() -> None:
    times, clock = np.arange(40) / 30, Clock(30.0)
    times[17] += 50_000
    np.testing.assert_allclose([clock.seconds(float(time)) for time in times], np.arange(40) / 30, atol=1e-6)


@pytest.mark.parametrize("pause", [10.0, 600.0, 3000.0])
def test_a_recorder_that_pauses_keeps_its_clock(pause: float) -> None:
    times, clock = np.arange(40) / 30, Clock(30.0)
    times[20:] += pause
    np.testing.assert_allclose([clock.seconds(float(time)) for time in times], times, atol=1e-6)
    assert not clock.notes


@pytest.mark.parametrize(("orientation", "turns"), [(1, 0), (3, 2), (6, 3), (8, 1)])
def test_motion_jpeg_is_turned_as_its_exif_says(tmp_path: Path, orientation: int, turns: int) -> None:
    """Frames of a camera's film, each with EXIF, which PyAV has no name for; turns: of 90 degrees against the clock."""
    stored = np.repeat(np.repeat(np.array([[250, 170], [90, 10]], np.uint8), 32, axis=0), 48, axis=1)
    jpeg = cv2.imencode(".jpg", np.dstack([stored] * 3))[1].tobytes()
    exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0" + bytes([orientation]) + b"\0" * 7
    film = tmp_path / "film.mjpeg"
    film.write_bytes(3 * (jpeg[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + jpeg[2:]))
    frames = [frame.rgb[..., 0] for frame in Source(film)]
    assert len(frames) == 3
    np.testing.assert_allclose(frames[0], np.rot90(stored, turns), atol=12)


def encode(path: Path, sizes: list[int], shade: int = 0, start: int = 0) -> Path:
    """A video of a moving bar, a frame for each size."""
    with av.open(str(path), "w") as file:
        stream = file.add_stream("mpeg2video", rate=25)
        stream.width = stream.height = sizes[0]
        stream.pix_fmt, stream.bit_rate, stream.time_base = "yuv420p", 4_000_000, Fraction(1, 25)
        for number, size in enumerate(sizes):
            picture = np.full((size, size, 3), shade, np.uint8)
            picture[:, 4 * number % size :][:, :8] = 200
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts = start + number
            file.mux(stream.encode(frame))
        file.mux(stream.encode())
    return path


def test_joined_segments_go_on_behind_each_other(tmp_path: Path) -> None:
    parts = [encode(tmp_path / f"{k}.ts", [96] * 20) for k in range(3)]
    joined = tmp_path / "joined.ts"
    joined.write_bytes(b"".join(part.read_bytes() for part in parts))
    source = Source(joined)
    seconds = np.array([frame.seconds for frame in source])
    np.testing.assert_allclose(seconds, np.arange(60) / 25, atol=0.021)
    assert any("run backwards 2 times" in note for note in source.notes)


def test_a_size_that_changes_is_brought_to_the_first_and_said_once(tmp_path: Path) -> None:
    film = tmp_path / "film.ts"
    film.write_bytes(
        encode(tmp_path / "a.ts", [96] * 10).read_bytes() + encode(tmp_path / "b.ts", [128] * 10).read_bytes()
    )
    source = Source(film)
    assert {frame.rgb.shape for frame in source} == {(96, 96, 3)}
    assert sum("from 96x96 to 128x128 px" in note for note in source.notes) == 1


def test_a_shape_that_changes_is_one_sentence(tmp_path: Path) -> None:
    source = Source(encode(tmp_path / "a.ts", [96] * 3))
    list(source)
    with pytest.raises(HaustraError, match="from 96x96 to 160x96 px at frame 7: cut it there"):
        source._of_size(np.zeros((96, 160, 3), np.uint8), (96, 96), 7)


@pytest.mark.parametrize(("size", "count"), [(64, 1), (192, 1), (64, 20), (64, 60)])
def test_the_film_is_taken_not_the_still_or_the_small_view_before_it(tmp_path: Path, size: int, count: int) -> None:
    """A label, a large cover, and a small view that is as long as the film or longer."""
    path = tmp_path / "film.mkv"
    with av.open(str(path), "w") as file:
        streams = [(file.add_stream("mpeg4", rate=25), *of) for of in ((size, count), (96, 20))]
        for stream, side, _ in streams:
            stream.width = stream.height = side
            stream.pix_fmt = "yuv420p"
        for number in range(max(20, count)):
            for stream, side, last in streams:
                if number < last:
                    shade = np.full((side, side, 3), 4 * number, np.uint8)
                    frame = av.VideoFrame.from_ndarray(shade, format="rgb24")
                    frame.pts = number
                    file.mux(stream.encode(frame))
        for stream, _, _ in streams:
            file.mux(stream.encode())
    source = Source(path)
    frames = list(source)
    assert len(frames) == 20
    assert frames[0].rgb.shape == (96, 96, 3)
    assert any("of 2 video streams number 1 was taken" in note for note in source.notes)


def test_an_edit_list_that_cuts_the_beginning_is_no_early_end(tmp_path: Path) -> None:
    """As phones and players trim without coding anew: FFmpeg starts at a time before the first that is shown."""
    whole, cut = encode(tmp_path / "whole.ts", [96] * 50), tmp_path / "cut.mp4"
    with av.open(str(whole)) as given, av.open(str(cut), "w", options={"avoid_negative_ts": "disabled"}) as file:
        stream = file.add_stream_from_template(given.streams.video[0])
        first = None
        for packet in given.demux(video=0):
            if packet.dts is None:
                continue
            first = packet.pts if first is None else first
            late = first + round(0.8 / packet.time_base)
            packet.pts, packet.dts, packet.stream = packet.pts - late, packet.dts - late, stream
            file.mux(packet)
    source = Source(cut)
    assert 25 <= len(list(source)) <= 32
    assert not source.notes


def test_a_name_with_a_colon_is_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    encode(tmp_path / "plain.ts", [96] * 5).rename(tmp_path / "10:30:00.ts")
    monkeypatch.chdir(tmp_path)
    assert len(list(Source(Path("10:30:00.ts")))) == 5


@pytest.mark.parametrize("height", [8, 9])
def test_the_upper_field_stays_in_its_rows_and_the_lower_one_leaves_no_trace(height: int) -> None:
    """Upper rows on a ramp, lower rows of another time at 255: what comes out is the ramp, to its last row."""
    ramp = 20 * np.arange(height, dtype=np.uint8)
    frame = np.repeat(np.where(np.arange(height) % 2, 255, ramp).astype(np.uint8), 6).reshape(height, 2, 3)
    shown = upper_field(frame)
    last = height - 1 - (height - 1) % 2  # the last upper row, which is repeated below it
    np.testing.assert_array_equal(shown[:, 0, 0], np.minimum(ramp, ramp[last]))


def test_a_stream_that_begins_later_loses_no_picture_of_the_film(tmp_path: Path) -> None:
    """PyAV knows the streams of the beginning alone and ends on a packet of another."""
    from pipeline.input.decoding import packets_of

    class Container:
        calls = 0

        def demux(self, _):
            Container.calls += 1
            yield Container.calls
            if Container.calls < 4:
                raise IndexError("list index out of range")

    assert list(packets_of(Container(), None)) == [1, None, 2, None, 3, None, 4]
