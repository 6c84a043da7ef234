"""Small videos, and pictures of points, made on the spot."""

import struct
from collections.abc import Iterable, Sequence
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray


def write_video(path: Path, frames: Sequence[NDArray[np.uint8]], fps: int = 30, **options: str) -> Path:
    """H.264, with the index in front so that a truncated file still opens."""
    with av.open(str(path), "w", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("libx264", rate=fps)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": "16", **options}
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())
    return path


def without_packets(path: Path, lost: Iterable[int]) -> Path:
    """The same transport stream, which lost some of its pictures' packets on its way."""
    data = path.read_bytes()
    with av.open(str(path)) as film:
        places = [packet.pos for packet in film.demux(video=0) if packet.pos is not None]
    gone = [range(places[k], places[k + 1]) for k in lost]
    kept = [data[k : k + 188] for k in range(0, len(data), 188) if not any(k in one for one in gone)]
    path.write_bytes(b"".join(kept))
    return path


def textured_frames(count: int, size: int = 160, seed: int = 0, step: int = 4) -> list[NDArray[np.uint8]]:
    """A smooth random texture that slides by `step` pixels a frame."""
    rng = np.random.default_rng(seed)
    texture = np.zeros((size, size + step * count), np.float32)
    for cell in (4, 8, 24):
        noise = rng.normal(size=(size // cell + 2, (size + step * count) // cell + 2)).astype(np.float32)
        texture += cv2.resize(noise, texture.shape[::-1], interpolation=cv2.INTER_CUBIC)
    # Grey-pink, since video stores colour at half the resolution.
    texture = np.clip((110 + 22 * texture)[..., None] * (1.0, 0.8, 0.75), 0, 235).astype(np.uint8)
    return [np.ascontiguousarray(texture[:, i * step : i * step + size]) for i in range(count)]


def tiff_of_floats(values):
    """A baseline TIFF of (H,W,3) float32 by the specification: one strip, chunky, IEEE floats."""
    height, width, _ = values.shape
    data = np.ascontiguousarray(values, "<f4").tobytes()
    after = 8 + len(data)
    tags = [(256, 3, 1, width), (257, 3, 1, height), (258, 3, 3, after), (259, 3, 1, 1), (262, 3, 1, 2), (273, 4, 1, 8)]
    tags += [(277, 3, 1, 3), (278, 3, 1, height), (279, 4, 1, len(data)), (284, 3, 1, 1), (339, 3, 3, after + 6)]
    extra = struct.pack("<6H", 32, 32, 32, 3, 3, 3)
    directory = struct.pack("<H", len(tags)) + b"".join(struct.pack("<HHII", *tag) for tag in tags) + bytes(4)
    return struct.pack("<2sHI", b"II", 42, after + len(extra)) + data + extra + directory
