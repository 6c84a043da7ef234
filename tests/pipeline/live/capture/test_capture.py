"""Live frames: their pace, what is skipped, what is recorded, and how each kind of loss is told."""

from __future__ import annotations

import socket
import threading
import time
from contextlib import suppress

import av
import numpy as np
import pytest

from haustra.core.errors import HaustraError
from pipeline.input.video import RawFrame
from pipeline.live.capture.frame_feed import FrameFeed
from pipeline.live.capture.growing_file import GrowingFile
from pipeline.live.capture.live_film import PlayedFilm, open_film
from pipeline.live.capture.stream import Stream
from tests.helpers.videos import textured_frames, write_video

FPS, COUNT = 50, 12


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    return write_video(tmp_path_factory.mktemp("film") / "film.mp4", textured_frames(COUNT, 64), FPS)


def decoded(path):
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


class _Film:
    """Gives `count` frames at once, then waits to be stopped, or fails."""

    name, recording = "film", None

    def __init__(self, count, error=None):
        self.count, self.error = count, error

    def frames(self, stopped):
        for index in range(self.count):
            yield RawFrame(index, index / 30, np.zeros((4, 4, 3), np.uint8))
        if self.error is not None:
            raise self.error
        stopped.wait(10)


def test_a_film_is_played_at_its_own_rate_and_goes_on_in_the_next_round(film):
    began = time.monotonic()
    frames = [(f.index, f.seconds, time.monotonic() - began) for f in PlayedFilm(film, 2).frames(threading.Event())]
    index, seconds, when = (np.array(column) for column in zip(*frames, strict=True))
    assert index.tolist() == list(range(2 * COUNT))
    np.testing.assert_allclose(np.diff(seconds), 1 / FPS, atol=1e-3)
    assert np.all(when - when[0] >= seconds - seconds[0] - 1e-3)


def test_a_stopped_film_ends_at_once(film):
    stopped = threading.Event()
    frames = PlayedFilm(film, 1000).frames(stopped)
    next(frames)
    stopped.set()
    assert list(frames) == []


def test_the_buffer_does_not_grow_and_what_is_skipped_is_counted():
    with FrameFeed(_Film(40), buffered=5) as feed:
        end = time.monotonic() + 10
        while feed.came < 40 and time.monotonic() < end:
            time.sleep(0.01)
        taken = [feed.take(0.05).raw.index for _ in range(5)]
        assert feed.take(0.05) is None
    assert taken == [35, 36, 37, 38, 39]
    assert (feed.came, feed.skipped) == (40, 35)


def test_a_lost_source_is_told_after_its_last_frame():
    with FrameFeed(_Film(2, HaustraError("the cable is out"))) as feed:
        assert [feed.take(5).raw.index for _ in range(2)] == [0, 1]
        assert feed.take(5) is None
        assert feed.ended
    assert feed.fault == "the cable is out"


def test_what_nobody_expected_is_raised_where_the_next_frame_is_asked_for():
    feed = FrameFeed(_Film(1, ZeroDivisionError()))
    with pytest.raises(ZeroDivisionError), feed:
        list(iter(lambda: feed.take(5), None))
    with pytest.raises(ZeroDivisionError), FrameFeed(_Film(1, ZeroDivisionError())):
        time.sleep(0.2)  # nobody asks


def test_a_growing_file_is_waited_for_and_ends_when_it_stays_as_it_is(tmp_path):
    path = tmp_path / "film.ts"
    path.write_bytes(b"begin")

    def write():
        time.sleep(0.2)
        with path.open("ab") as file:
            file.write(b"end")

    writer = threading.Thread(target=write)
    file = GrowingFile(path, threading.Event(), patience_s=0.6)
    writer.start()
    assert [file.read(5), file.read(9), file.read(9)] == [b"begin", b"end", b""]
    writer.join()
    file.close()


@pytest.fixture(scope="module")
def sent(film, tmp_path_factory):
    """The film's packets as an MPEG transport stream, as another program would send or write them."""
    path = tmp_path_factory.mktemp("sent") / "film.ts"
    with av.open(str(film)) as source, av.open(str(path), "w", "mpegts") as out:
        stream = out.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.dts is not None:
                packet.stream = stream
                out.mux(packet)
    return path.read_bytes()


def in_pieces(content, write):
    for start in range(0, len(content), 4096):
        write(content[start : start + 4096])
        time.sleep(0.005)


def test_a_stream_is_recorded_packet_by_packet(film, sent, tmp_path):
    """What is decoded from the recording is, bit by bit, what was sent."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def send():
            connection, _ = server.accept()
            with connection:
                in_pieces(sent, connection.sendall)

        sender = threading.Thread(target=send, daemon=True)
        sender.start()
        stream = open_film(f"tcp://127.0.0.1:{server.getsockname()[1]}", tmp_path)
        with FrameFeed(stream, buffered=100) as feed:
            shown = []
            while not feed.ended:
                fed = feed.take(1)
                if fed is not None:
                    shown.append(fed.raw)
    assert feed.fault == ""
    assert [frame.index for frame in shown] == list(range(COUNT))
    for one, other, recorded in zip(shown, decoded(film), decoded(stream.recording), strict=True):
        np.testing.assert_array_equal(one.rgb, other)
        np.testing.assert_array_equal(recorded, other)


def test_frames_without_stamps_are_recorded_too(film, tmp_path):
    """A bare H.264 stream has none."""
    path = tmp_path / "film.h264"
    with av.open(str(film)) as source, av.open(str(path), "w", "h264") as out:
        stream = out.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.size:
                packet.stream = stream
                out.mux(packet)
    recording = tmp_path / "film.mkv"
    shown = list(Stream(str(path), recording).frames(threading.Event()))
    assert len(shown) == COUNT
    for one, other in zip(decoded(recording), decoded(film), strict=True):
        np.testing.assert_array_equal(one, other)
    assert len(list(PlayedFilm(recording).source)) == COUNT


def test_a_stream_without_a_picture_leaves_an_earlier_recording(film, tmp_path):
    """Packets come, but none that can be decoded: what they need was never sent."""
    path, recording = tmp_path / "film.ts", tmp_path / "film.mkv"
    with av.open(str(film)) as source, av.open(str(path), "w", "mpegts") as out:
        stream = out.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.size and not packet.is_keyframe:
                packet.stream = stream
                out.mux(packet)
    recording.write_bytes(b"earlier")
    with suppress(HaustraError):
        assert list(Stream(str(path), recording).frames(threading.Event())) == []
    assert recording.read_bytes() == b"earlier"


def test_a_writer_that_dies_loses_little(tmp_path):
    """What lies on the disk while the recording is still open."""
    film = write_video(tmp_path / "film.mp4", textured_frames(60, 64), 30)
    recording, copy = tmp_path / "film.mkv", tmp_path / "copy.mkv"
    frames = Stream(str(film), recording).frames(threading.Event())
    for _ in range(50):
        next(frames)
    copy.write_bytes(recording.read_bytes())
    frames.close()
    with av.open(str(copy)) as container:
        kept = sum(packet.size > 0 for packet in container.demux(video=0))
    assert kept >= 50 - 0.6 * 30


def test_a_growing_film_is_read_to_its_end(sent, tmp_path, monkeypatch):
    monkeypatch.setattr(GrowingFile.__init__, "__defaults__", (1.0,))
    path = tmp_path / "film.ts"
    path.touch()

    def write():
        with path.open("ab", buffering=0) as file:
            in_pieces(sent, file.write)

    writer = threading.Thread(target=write)
    writer.start()
    frames = list(open_film(str(path), tmp_path / "run", grows=True).frames(threading.Event()))
    writer.join()
    assert len(frames) == COUNT
    assert not (tmp_path / "film.mkv").exists()


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("nowhere.mp4", "there is no file or folder nowhere.mp4"),
        ("gopher://here", "a stream's address begins with"),
        ("/dev/video99", "there is no camera /dev/video99"),
        ("99", "there is no camera /dev/video99"),
    ],
)
def test_a_source_that_is_none_is_refused_in_a_sentence(name, words, tmp_path):
    with pytest.raises(HaustraError, match=words):
        open_film(name, tmp_path)


def test_a_stream_that_nobody_sends_is_one_sentence(tmp_path):
    with pytest.raises(HaustraError, match=r"^the source tcp://127.0.0.1:1 cannot be opened: Connection refused$"):
        next(Stream("tcp://127.0.0.1:1", tmp_path / "film.mkv").frames(threading.Event()))


def test_a_password_is_neither_shown_nor_kept(tmp_path):
    for secret in (
        "rtsp://me:p@s/s?@10.0.0.5:554/scope",
        "srt://10.0.0.5:554/scope?passphrase=p",
        "rtmp://me:p@10.0.0.5",
    ):
        try:
            shown = open_film(secret, tmp_path).name
        except HaustraError as error:  # a kind of address that is not read
            shown = str(error)
        assert "10.0.0.5" in shown
        assert "me:p" not in shown
        assert "passphrase" not in shown


def test_a_folder_cannot_grow(tmp_path):
    with pytest.raises(HaustraError, match="is a folder"):
        open_film(str(tmp_path), tmp_path / "run", grows=True)
