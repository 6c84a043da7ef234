"""Films and folders that a player shows rightly, written in ways that readers get wrong, each seeded.

The frames are whole; only how they are stored is strange. So the result has a truth: a pose and a time for each frame.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from numpy.typing import NDArray

Frames = list[NDArray[np.uint8]]
RATE = 30
TKHD_MATRIX = 44  # bytes from the letters to the matrix, version 0 (ISO 14496-12, 8.3.2)


@dataclass(frozen=True)
class Strange:
    """What is given to `reconstruct`: source, and the rows of the frames that it shows with the time of each, s."""

    source: Path
    rows: list[int]
    seconds: list[float]
    camera: dict[str, Any] = field(default_factory=dict)  # where it is another than the frames'
    encoding: str = "utf-8"  # of the camera file


def encode(
    path: Path, frames: Frames, codec: str = "libx264", stamps: list[int] | None = None, rate: int = RATE, **more: Any
) -> None:
    """Write frames (H,W,3) of one size; more: pix_fmt, options, sample_aspect_ratio, start (in frames)."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=rate)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt, stream.bit_rate = more.get("pix_fmt", "yuv420p"), 8_000_000
        stream.options = {"crf": "16"} | more.get("options", {}) if codec.startswith("libx26") else {}
        if "sample_aspect_ratio" in more:
            stream.codec_context.sample_aspect_ratio = more["sample_aspect_ratio"]
        if codec.startswith("mpeg"):
            stream.options = {"bf": str(more.get("bf", 0)), "g": "12"}
        stream.codec_context.time_base = Fraction(1, rate)
        for number, frame in enumerate(frames):
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")
            picture.pts = more.get("start", 0) + (number if stamps is None else stamps[number])
            picture.time_base = Fraction(1, rate)
            container.mux(stream.encode(picture))
        container.mux(stream.encode())


def _all(source: Path, count: int, **more: Any) -> Strange:
    return Strange(source, list(range(count)), [k / RATE for k in range(count)], **more)


def plain(frames: Frames, rng: np.random.Generator, folder: Path) -> Strange:
    encode(folder / "film.mp4", frames)
    return _all(folder / "film.mp4", len(frames))


def turned_and_mirrored(frames: Frames, rng: np.random.Generator, folder: Path) -> Strange:
    """One of the eight display matrices; the pixels stored so that a player shows the film."""
    matrix = np.diag(rng.choice([-1, 1], 2))
    if rng.random() < 0.5:
        matrix = matrix[::-1]
    height, width = frames[0].shape[:2]
    y, x = np.mgrid[:height, :width]  # the picture is square, so stored and shown have one grid
    u, v = np.einsum("ij,jhw->ihw", matrix, np.stack([x, y]))
    stored = [np.ascontiguousarray(frame[v - v.min(), u - u.min()]) for frame in frames]
    encode(folder / "film.mp4", stored)
    data = bytearray((folder / "film.mp4").read_bytes())
    at = data.index(b"tkhd") + TKHD_MATRIX
    (a, c), (b, d) = (matrix * 65536).tolist()
    data[at : at + 36] = np.array([a, b, 0, c, d, 0, 0, 0, 1 << 30], ">i4").tobytes()
    (folder / "film.mp4").write_bytes(bytes(data))
    return _all(folder / "film.mp4", len(frames))


def joined(frames: Frames, rng: np.random.Generator, folder: Path) -> Strange:
    """Segments of a recorder, laid end to end: the clock starts again with each."""
    third = len(frames) // 3
    cuts = [0, int(rng.integers(third - 3, third + 3)), int(rng.integers(2 * third - 3, 2 * third + 3))]
    cuts = cuts if rng.random() < 0.5 else cuts[:2]
    parts = []
    for number, (first, last) in enumerate(zip(cuts, [*cuts[1:], len(frames)], strict=True)):
        encode(folder / f"part{number}.ts", frames[first:last], "mpeg2video")
        parts.append((folder / f"part{number}.ts").read_bytes())
    (folder / "film.ts").write_bytes(b"".join(parts))
    return _all(folder / "film.ts", len(frames))


def late_clock(frames: Frames, rng: np.random.Generator, folder: Path) -> Strange:
    encode(folder / "film.ts", frames, start=int(rng.integers(1, 40_000)) * RATE)
    return _all(folder / "film.ts", len(frames))


def avi(frames: Frames, rng: np.random.Generator, folder: Path) -> Strange:
    encode(folder / "film.avi", frames, str(rng.choice(["mpeg4", "libx264"])), bf=int(rng.integers(0, 3)))
    return _all(folder / "film.avi", len(frames))


def cover_first(frames: Frames, rng: np.random.Generator, folder: Path) -> Strange:
    with av.open(str(folder / "film.mkv"), "w") as file:
        still, film = file.add_stream("mjpeg", rate=RATE), file.add_stream("libx264", rate=RATE)
        still.width = still.height = int(rng.choice([64, 400]))
        still.pix_fmt = "yuvj420p"
        film.height, film.width = frames[0].shape[:2]
        film.pix_fmt, film.options = "yuv420p", {"crf": "16"}
        label = rng.integers(0, 256, (still.height, still.width, 3), dtype=np.uint8)
        file.mux(still.encode(av.VideoFrame.from_ndarray(label, format="rgb24")))
        for frame in frames:
            file.mux(film.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        file.mux(still.encode())
        file.mux(film.encode())
    return _all(folder / "film.mkv", len(frames))


def size_changes(frames: Frames, rng: np.random.Generator, folder: Path) -> Strange:
    cut, side = int(rng.integers(len(frames) // 3, 2 * len(frames) // 3)), int(rng.choice([240, 256, 400, 480]))
    in_order = {"bf": "0"}  # with frames out of order each part's clock would begin two frames late
    encode(folder / "a.ts", frames[:cut], options=in_order)
    encode(folder / "b.ts", [cv2.resize(f, (side, side)) for f in frames[cut:]], start=cut, options=in_order)
    (folder / "film.ts").write_bytes((folder / "a.ts").read_bytes() + (folder / "b.ts").read_bytes())
    return _all(folder / "film.ts", len(frames))


def interlaced(frames: Frames, rng: np.random.Generator, folder: Path) -> Strange:
    """Rows of two times, flagged or not; half as many frames. The upper field is the first one."""
    woven = []
    for upper, lower in zip(frames[::2], frames[1::2], strict=False):
        whole = lower.copy()
        whole[::2] = upper[::2]
        woven.append(whole)
    flag = {"x264-params": "interlaced=1"} if rng.random() < 0.5 else {}
    encode(folder / "film.mp4", woven, options=flag, rate=RATE // 2, pix_fmt="yuv444p")
    return Strange(folder / "film.mp4", list(range(0, 2 * len(woven), 2)), [2 * k / RATE for k in range(len(woven))])


def deep_pictures(frames: Frames, rng: np.random.Generator, folder: Path) -> Strange:
    bits = int(rng.choice([10, 12, 14, 16]))
    (folder / "film").mkdir()
    for number, frame in enumerate(frames):
        deep = frame.astype(np.float64) * (2**bits - 1) / 255
        cv2.imwrite(str(folder / "film" / f"{number}.png"), np.rint(deep).astype(np.uint16)[..., ::-1])
    return _all(folder / "film", len(frames))


def pictures_of_a_mac(frames: Frames, rng: np.random.Generator, folder: Path) -> Strange:
    """Any format, "._" companions, and names that are numbers without zeros before, or decimal seconds."""
    suffix = str(rng.choice(["jpg", "png", "webp", "jp2", "ppm", "bmp", "tif"]))
    decimal = rng.random() < 0.5
    (folder / "film").mkdir()
    for number, frame in enumerate(frames):
        name = f"{number / 100:.4f}".rstrip("0") + "0" * (number % 100 == 0) if decimal else f"frame {number}"
        cv2.imwrite(str(folder / "film" / f"{name}.{suffix}"), frame[..., ::-1])
        (folder / "film" / f"._{name}.{suffix}").write_bytes(b"\x00\x05\x16\x07\x00")
    return _all(folder / "film", len(frames))


def strange_name(frames: Frames, rng: np.random.Generator, folder: Path) -> Strange:
    name = str(rng.choice(["10:30:00.mp4", "film%03d.mp4", "fälm [1].mp4", "-film.mp4", "a b's.mp4", "film.mp4.part"]))
    encode(folder / "film.mp4", frames)
    (folder / "film.mp4").rename(folder / name)
    return _all(folder / name, len(frames))


def stretched(frames: Frames, rng: np.random.Generator, folder: Path) -> Strange:
    """Pixels that are not square: the picture is stored narrower than it is shown."""
    height, width = frames[0].shape[:2]
    narrow = int(rng.choice([width // 2, width * 3 // 4, width * 9 // 10]))
    stored = [cv2.resize(frame, (narrow, height), interpolation=cv2.INTER_AREA) for frame in frames]
    encode(folder / "film.mp4", stored, sample_aspect_ratio=Fraction(width, narrow))
    return _all(folder / "film.mp4", len(frames))


def camera_of_windows(frames: Frames, rng: np.random.Generator, folder: Path) -> Strange:
    encode(folder / "film.mp4", frames)
    return _all(folder / "film.mp4", len(frames), encoding=str(rng.choice(["utf-8-sig", "utf-16", "utf-16-le"])))


def camera_of_another_size(frames: Frames, rng: np.random.Generator, folder: Path) -> Strange:
    factor = int(rng.integers(2, 5))
    encode(folder / "film.mp4", frames)
    return _all(folder / "film.mp4", len(frames), camera={"factor": factor})


def bare_stream(frames: Frames, rng: np.random.Generator, folder: Path) -> Strange:
    """No container: a frame rate at most, and no times. Such a stream is played at 25 frames a second or its own."""
    codec, suffix = [("libx264", "h264"), ("libx265", "hevc"), ("mjpeg", "mjpeg")][int(rng.integers(0, 3))]
    encode(folder / f"film.{suffix}", frames, codec, pix_fmt="yuvj420p" if codec == "mjpeg" else "yuv420p")
    rate = 25 if codec == "mjpeg" else RATE
    return Strange(folder / f"film.{suffix}", list(range(len(frames))), [k / rate for k in range(len(frames))])


def uneven(frames: Frames, rng: np.random.Generator, folder: Path) -> Strange:
    """A recorder that leaves frames out and says when each was taken."""
    rows = [0, *[k for k in range(1, len(frames)) if rng.random() > 0.25]]
    encode(folder / "film.mkv", [frames[k] for k in rows], stamps=rows)
    return Strange(folder / "film.mkv", rows, [k / RATE for k in rows])


def other_codec(frames: Frames, rng: np.random.Generator, folder: Path) -> Strange:
    codec, name, form = [
        ("libvpx-vp9", "film.webm", "yuv420p"),
        ("libx265", "film.mp4", "yuv420p10le"),
        ("ffv1", "film.mkv", "yuv444p"),
        ("wmv2", "film.wmv", "yuv420p"),
        ("mjpeg", "film.mov", "yuvj444p"),
    ][int(rng.integers(0, 5))]
    encode(folder / name, frames, codec, pix_fmt=form)
    return _all(folder / name, len(frames))


STRANGE: dict[str, Callable[[Frames, np.random.Generator, Path], Strange]] = {
    function.__name__: function
    for function in (
        plain, turned_and_mirrored, joined, late_clock, avi, cover_first, size_changes, interlaced, deep_pictures,
        pictures_of_a_mac, strange_name, stretched, camera_of_windows, camera_of_another_size, bare_stream, uneven,
        other_codec,
    )
}  # fmt: skip


def write_camera(path: Path, camera: dict[str, Any], strange: Strange) -> None:
    """The frames' camera as the case has it: of larger pictures, or in another encoding."""
    factor = strange.camera.get("factor", 1)
    made = camera | {"width": camera["width"] * factor, "height": camera["height"] * factor}
    made["params"] = [factor * value for value in camera["params"]]
    text = json.dumps(made, indent=1)
    path.write_bytes((b"\xff\xfe" if strange.encoding == "utf-16-le" else b"") + text.encode(strange.encoding))
