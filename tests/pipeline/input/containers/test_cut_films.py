"""Films that are cut off say so where their files name a length, and whole ones say nothing."""

from __future__ import annotations

import struct
from pathlib import Path

import av
import pytest
from PIL import Image

from pipeline.input.video import Source
from tests.helpers.real_data import shared
from tests.helpers.videos import textured_frames, write_video

COUNT, RATE = 50, 25
CODECS = {"flv": "flv1", "wmv": "wmv2", "mxf": "mpeg2video", "mkv": "libx264", "mpg": "mpeg2video"}


def film_of(folder: Path, suffix: str, **options: str) -> bytes:
    """A whole film of two seconds."""
    path, frames = folder / f"whole.{suffix}", textured_frames(COUNT, size=96)
    if suffix == "gif":
        first, *others = [Image.fromarray(frame).convert("P") for frame in frames]
        first.save(path, save_all=True, append_images=others, duration=40)
        return path.read_bytes()
    with av.open(str(path), "w", options=options) as file:
        stream = file.add_stream(CODECS.get(suffix, "libx264"), rate=RATE)
        stream.width, stream.height, stream.pix_fmt = 96, 96, "yuv420p"
        stream.gop_size = 5
        for frame in frames:
            file.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        file.mux(stream.encode())
    return path.read_bytes()


def endings(path: Path, data: bytes) -> tuple[int, list[str]]:
    """Frames of a film with these bytes, and what is said of its end."""
    path.write_bytes(data)
    source = Source(path)
    return len(list(source)), [note for note in source.notes if "ends early" in note or "has gaps" in note]


@pytest.mark.parametrize("suffix", ["flv", "wmv", "mxf", "mkv"])
@pytest.mark.parametrize("share", [0.3, 0.6])  # the last fifth of the WMV is its index
def test_a_cut_film_says_how_much_of_its_named_length_is_there(tmp_path: Path, suffix: str, share: float) -> None:
    data = film_of(tmp_path, suffix)
    assert endings(tmp_path / f"film.{suffix}", data) == (COUNT, [])
    count, told = endings(tmp_path / f"film.{suffix}", data[: int(share * len(data))])
    assert count < COUNT - 1
    assert len(told) == 1
    assert told[0].endswith(" of 2.0 s could be decoded")


@pytest.mark.parametrize(("suffix", "flags"), [("mp4", "frag_keyframe+empty_moov+default_base_moof"), ("gif", "")])
@pytest.mark.parametrize("share", [0.4, 0.75])
def test_a_film_that_names_no_length_is_told_where_it_ends_inside_a_piece(
    tmp_path: Path, suffix: str, flags: str, share: float
) -> None:
    data = film_of(tmp_path, suffix, **({"movflags": flags} if flags else {}))
    assert endings(tmp_path / f"film.{suffix}", data) == (COUNT, [])
    count, told = endings(tmp_path / f"film.{suffix}", data[: int(share * len(data))])
    assert count < COUNT
    assert told == ["the video ends early: its file is cut off"]


def with_named_length(data: bytes, seconds: float) -> bytes:
    """A fragmented MP4 with the box `mehd`, in its time scale of 1000."""
    extends, movie = data.index(b"mvex") - 4, data.index(b"moov") - 4
    mehd = struct.pack(">I4sII", 16, b"mehd", 0, round(1000 * seconds))
    grown = bytearray(data[: extends + 8] + mehd + data[extends + 8 :])
    for at in (extends, movie):
        grown[at : at + 4] = struct.pack(">I", struct.unpack(">I", grown[at : at + 4])[0] + 16)
    return bytes(grown)


def test_a_fragmented_film_that_is_cut_between_fragments_is_told_by_the_length_that_it_names(tmp_path: Path) -> None:
    whole = film_of(tmp_path, "mp4", movflags="frag_keyframe+empty_moov+default_base_moof")
    data = with_named_length(whole, COUNT / RATE)
    assert endings(tmp_path / "film.mp4", data) == (COUNT, [])
    cut = [at for at in range(len(data)) if data[at + 4 : at + 8] == b"moof"][6]
    assert endings(tmp_path / "film.mp4", whole[: cut - 16])[1] == []  # nothing names what is missing
    count, told = endings(tmp_path / "film.mp4", data[:cut])
    assert 20 < count < 35
    assert told == [f"the video ends early: {count / RATE:.1f} of 2.0 s could be decoded"]


def test_sound_that_goes_on_after_the_pictures_is_no_end_that_is_missing(tmp_path: Path) -> None:
    film = tmp_path / "film.flv"
    with av.open(str(film), "w") as file:
        stream, sound = file.add_stream("flv1", rate=RATE), file.add_stream("pcm_s16le", rate=44100)
        stream.width, stream.height, stream.pix_fmt = 96, 96, "yuv420p"
        sound.layout = "mono"
        for frame in textured_frames(COUNT, size=96):
            file.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        file.mux(stream.encode())
        for number in range(3 * RATE):
            silence = av.AudioFrame(format="s16", layout="mono", samples=44100 // RATE)
            silence.sample_rate, silence.pts = 44100, number * (44100 // RATE)
            file.mux(sound.encode(silence))
        file.mux(sound.encode())
    assert endings(film, film.read_bytes()) == (COUNT, [])


def test_padding_at_the_end_of_a_short_program_stream_is_nothing_that_is_missing(tmp_path: Path) -> None:
    data = film_of(tmp_path, "mpg", packetsize="4096")
    data += b"\xff" * (4 * 2048)  # MPEG packs are filled with ones
    assert endings(tmp_path / "film.mpg", data) == (COUNT, [])
    assert len(endings(tmp_path / "film.mpg", data + b"\xff" * (1 << 20))[1]) == 1


def test_a_film_whose_beginning_is_cut_within_a_frame_has_all_its_frames(tmp_path: Path) -> None:
    """Of its edit list the length is known, and with it the number of frames but for one."""
    write_video(tmp_path / "whole.mp4", textured_frames(40, size=96), fps=30)
    data = bytearray((tmp_path / "whole.mp4").read_bytes())
    at = data.index(b"elst") + 12
    length, start = struct.unpack(">Ii", data[at : at + 8])
    scale = struct.unpack(">I", data[data.index(b"mdhd") + 16 :][:4])[0]
    data[at : at + 8] = struct.pack(">Ii", length - 512, start + round(0.512 * scale))
    count, told = endings(tmp_path / "film.mp4", bytes(data))
    assert 23 <= count <= 25
    assert told == []


@pytest.mark.parametrize("folder", ["realclips", "cases"])
def test_whole_films_of_the_world_are_not_called_cut(folder: str) -> None:
    films = [path for path in sorted(shared(folder).glob("**/*")) if path.suffix in (".mp4", ".ts", ".mkv")]
    whole = [path for path in films if path.name not in ("late_change.ts", "reschange.ts")]
    assert whole
    for path in whole:
        source = Source(path)
        assert len(list(source)) > 10
        assert not [note for note in source.notes if "ends early" in note or "gaps" in note], path
