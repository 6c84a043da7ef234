"""What a file announces of itself and does not keep: its length, the shape of its pixels, one picture a file."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from haustra.core.errors import HaustraError
from pipeline.input.video import Source
from tests.helpers.videos import textured_frames


def encode(path: Path, width: int = 96, aspect: str = "1:1", count: int = 20) -> bytes:
    """A film 96 px high, whose codec tells the shape of its pixels."""
    with av.open(str(path), "w") as file:
        stream = file.add_stream("libx264", rate=25, options={"aspect": aspect})
        stream.width, stream.height, stream.pix_fmt = width, 96, "yuv420p"
        for frame in textured_frames(count, size=96):
            file.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(frame[:, :width]), format="rgb24")))
        file.mux(stream.encode())
    return path.read_bytes()


def test_pixels_whose_shape_changes_are_no_picture_that_is_known_to_change(tmp_path: Path) -> None:
    """The decoder says of no frame which shape its pixels have."""
    film = tmp_path / "joined.ts"
    film.write_bytes(encode(tmp_path / "a.ts", 72, "4:3") + encode(tmp_path / "b.ts"))
    with pytest.raises(HaustraError, match=r"from 96x96 to 128x96 px \(if its pixels are 4/3 all along\) at frame 20"):
        list(Source(film))


@pytest.mark.parametrize("aspect", ["1:10", "10:1"])
def test_pixels_of_a_shape_that_none_has_are_square(tmp_path: Path, aspect: str) -> None:
    encode(tmp_path / "film.ts", aspect=aspect)
    source = Source(tmp_path / "film.ts")
    assert {frame.rgb.shape for frame in source} == {(96, 96, 3)}
    assert any("taken for square" in note for note in source.notes)


@pytest.mark.parametrize("share", [0.3, 0.6, 1.0])
def test_a_matroska_file_that_is_cut_says_how_much_of_it_is_there(tmp_path: Path, share: float) -> None:
    film = tmp_path / "film.mkv"
    data = encode(film, count=100)
    film.write_bytes(data[: int(share * len(data))])
    source = Source(film)
    seconds = len(list(source)) / 25
    told = [note for note in source.notes if "ends early" in note]
    assert told == ([] if share == 1 else [f"the video ends early: {seconds:.1f} of 4.0 s could be decoded"])


def test_a_matroska_file_whose_times_begin_late_is_whole(tmp_path: Path) -> None:
    encode(tmp_path / "whole.mp4", count=50)
    film = tmp_path / "film.mkv"
    with av.open(str(tmp_path / "whole.mp4")) as source, av.open(str(film), "w") as target:
        stream = target.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.dts is not None:
                packet.stream = stream
                packet.pts += round(7200 / packet.time_base)
                packet.dts += round(7200 / packet.time_base)
                target.mux(packet)
    source = Source(film)
    assert len(list(source)) == 50
    assert not [note for note in source.notes if "ends early" in note]


def test_a_gif_is_not_called_interlaced_for_its_dither(tmp_path: Path) -> None:
    """Rows that alternate where the picture moves, as an ordered dither's do."""
    film, frames = tmp_path / "film.gif", []
    for number, frame in enumerate(textured_frames(20, size=96)):
        rows = frame.copy()
        rows[1::2] = np.roll(frame, 6 + number, axis=1)[1::2]
        frames.append(Image.fromarray(rows).convert("P"))
    frames[0].save(film, save_all=True, append_images=frames[1:], duration=40)
    source = Source(film)
    assert len(list(source)) == 20
    assert not any("interlaced" in note for note in source.notes)


@pytest.mark.parametrize("in_folder", [False, True])
def test_a_stack_of_pictures_in_one_file_is_called_one(tmp_path: Path, in_folder: bool) -> None:
    stack = tmp_path / "stack01.tif"
    first, *others = [Image.fromarray(frame) for frame in textured_frames(7, size=64)]
    first.save(stack, save_all=True, append_images=others)
    with pytest.raises(HaustraError, match="is a stack of 7 pictures in one TIFF file"):
        Source(tmp_path if in_folder else stack)


def test_a_film_of_a_codec_that_nobody_has_is_one_sentence(tmp_path: Path) -> None:
    film = tmp_path / "film.avi"
    with av.open(str(film), "w") as file:
        stream = file.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt = 96, 96, "yuv420p"
        for frame in textured_frames(5, size=96):
            file.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        file.mux(stream.encode())
    film.write_bytes(film.read_bytes().replace(b"FMP4", b"Zzq9"))
    with pytest.raises(HaustraError, match="no frame of"):
        list(Source(film))
