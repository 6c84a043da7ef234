"""Tiny seeded inputs shared by the tests."""

import signal
import time
from collections.abc import Sequence
from pathlib import Path

import av
import cv2
import numpy as np
import psutil
import pytest
from numpy.typing import NDArray

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell's background job ignores Ctrl-C, and so would every process that the tests start and interrupt.
    signal.signal(signal.SIGINT, signal.default_int_handler)

if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:  # and what `nohup` starts ignores a lost terminal
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

# Half of the suite's time: begun first, so that no process is left with one of them when the others are done.
LONGEST = ("test_reconstruct.py", "test_chunks.py", "test_refit.py", "test_training.py", "test_joining.py")
SHARED_DATA = Path(__file__).parents[2] / "shared" / "data"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files first, the rest as they are."""
    items.sort(key=lambda item: LONGEST.index(item.path.name) if item.path.name in LONGEST else len(LONGEST))


def shared(name: str) -> Path:
    """A folder of real data beside the checkout; skips where it is absent."""
    folder = SHARED_DATA / name
    if not folder.is_dir():
        pytest.skip(f"real data '{name}' is not beside this checkout (../shared/data)")
    return folder


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


def alive(folder):
    """Processes whose command names the folder."""
    found = psutil.process_iter(["cmdline", "status"])
    return [
        p
        for p in found
        if any(str(folder) in word for word in p.info["cmdline"] or []) and p.info["status"] != "zombie"
    ]


def wait_for(condition, seconds=120):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never came to pass"
        time.sleep(0.05)
