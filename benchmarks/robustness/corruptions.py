"""Ways in which a video can be bad, each seeded: of its frames, of its file, of its camera file."""

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

Frames = list[NDArray[np.uint8]]  # (H,W,3) uint8 each
Damage = Callable[[Frames, np.random.Generator], Frames]


def dropped(frames: Frames, rng: np.random.Generator) -> Frames:
    share = rng.uniform(0.2, 0.8)
    return [frame for frame in frames if rng.random() > share] or frames[:1]


def duplicated(frames: Frames, rng: np.random.Generator) -> Frames:
    return [frame for frame in frames for _ in range(rng.integers(1, 4))]


def shuffled(frames: Frames, rng: np.random.Generator) -> Frames:
    return [frames[k] for k in rng.permutation(len(frames))]


def reversed_in_the_middle(frames: Frames, rng: np.random.Generator) -> Frames:
    a, b = sorted(rng.integers(0, len(frames), 2))
    return frames[:a] + frames[a:b][::-1] + frames[b:]


def frozen(frames: Frames, rng: np.random.Generator) -> Frames:
    start = int(rng.integers(0, len(frames)))
    return frames[:start] + [frames[start]] * (len(frames) - start)


def rotated(frames: Frames, rng: np.random.Generator) -> Frames:
    """From some frame on the picture stands on its head or on its side."""
    start, turns = int(rng.integers(0, len(frames))), int(rng.integers(1, 4))
    return frames[:start] + [np.ascontiguousarray(np.rot90(frame, turns)) for frame in frames[start:]]


def mirrored(frames: Frames, rng: np.random.Generator) -> Frames:
    start = int(rng.integers(0, len(frames)))
    return frames[:start] + [np.ascontiguousarray(frame[:, ::-1]) for frame in frames[start:]]


def zoomed(frames: Frames, rng: np.random.Generator) -> Frames:
    """A sudden digital zoom: the camera file no longer holds."""
    start, factor = int(rng.integers(0, len(frames))), rng.uniform(1.2, 3)
    height, width = frames[0].shape[:2]
    h, w = int(height / factor), int(width / factor)
    y, x = (height - h) // 2, (width - w) // 2
    return frames[:start] + [cv2.resize(frame[y : y + h, x : x + w], (width, height)) for frame in frames[start:]]


def blotted(frames: Frames, rng: np.random.Generator) -> Frames:
    """Stretches of black, white, red or noise."""
    result = list(frames)
    for _ in range(rng.integers(1, 5)):
        start, length = int(rng.integers(0, len(frames))), int(rng.integers(1, 12))
        kind = rng.integers(0, 4)
        for k in range(start, min(start + length, len(frames))):
            noise = rng.integers(0, 256, frames[0].shape, dtype=np.uint8)
            colour = ((0, 0, 0), (255, 255, 255), (200, 20, 20))[kind % 3]
            result[k] = noise if kind == 3 else np.full_like(frames[0], colour)
    return result


def spliced(frames: Frames, rng: np.random.Generator) -> Frames:
    """Cuts: stretches in another order, as an edited film has them."""
    cuts = np.sort(rng.choice(np.arange(1, len(frames)), 3, replace=False))
    parts = [frames[a:b] for a, b in zip([0, *cuts], [*cuts, len(frames)], strict=True)]
    return [frame for k in rng.permutation(len(parts)) for frame in parts[k]]


def flickering(frames: Frames, rng: np.random.Generator) -> Frames:
    gains = rng.uniform(0.1, 3, len(frames))
    return [np.clip(frame * gain, 0, 255).astype(np.uint8) for frame, gain in zip(frames, gains, strict=True)]


def overlaid(frames: Frames, rng: np.random.Generator) -> Frames:
    """A still picture covers a part of the view: texture that does not move."""
    height, width = frames[0].shape[:2]
    h, w = int(rng.uniform(0.3, 0.9) * height), int(rng.uniform(0.3, 0.9) * width)
    y, x = rng.integers(0, height - h), rng.integers(0, width - w)
    patch = rng.integers(0, 256, (h, w, 3), dtype=np.uint8)
    result = [frame.copy() for frame in frames]
    for frame in result:
        frame[y : y + h, x : x + w] = patch
    return result


def still(frames: Frames, rng: np.random.Generator) -> Frames:
    """A still scene with the sensor's noise alone."""
    noisy = [frames[0] + rng.normal(0, 4, frames[0].shape) for _ in frames]
    return [np.clip(frame, 0, 255).astype(np.uint8) for frame in noisy]


def turning(frames: Frames, rng: np.random.Generator) -> Frames:
    """The camera turns about its axis and does not move: no parallax at all."""
    height, width = frames[0].shape[:2]
    rate = rng.uniform(1, 6)
    spins = [cv2.getRotationMatrix2D((width / 2, height / 2), rate * k, 1) for k in range(len(frames))]
    return [cv2.warpAffine(frames[0], spin, (width, height)) for spin in spins]


def short(frames: Frames, rng: np.random.Generator) -> Frames:
    return frames[: int(rng.integers(1, 6))]


def tiny(frames: Frames, rng: np.random.Generator) -> Frames:
    side = int(rng.choice([2, 8, 16, 32, 48]))
    return [cv2.resize(frame, (side, side)) for frame in frames]


def left_alone(frames: Frames, _: np.random.Generator) -> Frames:
    return frames


OF_FRAMES: dict[str, Damage] = {
    function.__name__: function
    for function in (
        dropped, duplicated, shuffled, reversed_in_the_middle, frozen, rotated, mirrored, zoomed, blotted, spliced,
        flickering, overlaid, still, turning, short, tiny,
    )
}  # fmt: skip


def damage_file(path: Path, rng: np.random.Generator) -> None:
    """Cut the file off, or overwrite bytes at random."""
    data = bytearray(path.read_bytes())
    if rng.random() < 0.5:
        data = data[: int(rng.uniform(0, 1) * len(data))]
    else:
        for place in rng.integers(0, len(data), int(10 ** rng.uniform(0, 3))):
            data[place] = int(rng.integers(0, 256))
    path.write_bytes(bytes(data))


def wrong_camera(camera: dict, rng: np.random.Generator) -> str:
    """The text of a camera file that is wrong in one of many ways, up to not being one at all."""
    made = json.loads(json.dumps(camera))
    kind = int(rng.integers(0, 6))
    if kind == 0:
        factor = float(np.exp(rng.uniform(-1.5, 1.5)))
        made["params"][:2] = [p * factor for p in made["params"][:2]]
    elif kind == 1:
        made["params"][2:] = [p + float(rng.normal(0, 80)) for p in made["params"][2:]]
    elif kind == 2:
        made |= {"model": "OPENCV", "params": [*made["params"], *rng.normal(0, 0.5, 4).tolist()]}
    elif kind == 3:
        made["params"][int(rng.integers(0, 4))] = float("nan")
    elif kind == 4:
        made["width"] = int(rng.integers(-5, 5000))
    else:
        text = json.dumps(made)
        return text[: int(rng.integers(0, len(text)))]
    return json.dumps(made)
