"""How fast the phantom films, with everything on, beside the bare ray casting that it cannot do without.

    python -m benchmarks.speed phantom --runs 3 --json phantom_speed.json

Whole frames as `haustra phantom` writes them: geometry, two lights with shadows, light between walls, texture, stool,
fluid, defocus, motion blur, sharpening, noise, text, mask, 4:2:0, JPEG, PNG of picture and depth, H.264; then the same
with all five events, each for a second, of which peristalsis builds a new mesh each frame. The colon is built before
the clock starts (its time is printed too). The peer is Open3D's RaycastingScene casting the same primary rays on every
core and nothing else, in turn.
"""

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common.record import shown, spread
from haustra.phantom.config import PhantomConfig
from haustra.phantom.dataset.generate import film_into
from haustra.phantom.dataset.scenes import film_of
from haustra.phantom.dataset.script import Script, write_script
from haustra.phantom.dataset.suite import config_from
from haustra.phantom.imaging.render import Phantom
from haustra.phantom.raycaster import RayCaster

EVERYTHING = {
    "scene": "colon",
    "seed": 1,
    "appearance": {"stool": 0.03, "fluid": 0.03},
    "imaging": {
        "border": "octagon",
        "text": True,
        "shutter": 0.4,
        "defocus_px": 0.8,
        "sharpen": 0.4,
        "chroma_px": 2,
        "jpeg_quality": 90,
    },
    "events": {"red_outs": 1, "water_jets": 1, "bubbles": 1, "tools": 1, "peristalsis": 1},
}


def filmed(phantom: Phantom, script: Script) -> float:
    """Frames per second, written to disk."""
    with tempfile.TemporaryDirectory() as folder:
        start = time.monotonic()
        film_into(Path(folder), phantom, script)
        return len(script.world_from_camera) / (time.monotonic() - start)


def cast_only(caster: RayCaster, phantom: Phantom, world_from_camera: np.ndarray) -> float:
    start = time.monotonic()
    for transform in world_from_camera:
        caster.cast(transform[:3, 3], phantom.rays @ transform[:3, :3].T.astype(np.float32))
    return len(world_from_camera) / (time.monotonic() - start)


def measure_film(label: str, settings: dict[str, Any], runs: int, frames: int) -> dict[str, Any]:
    """Rates of one kind of film, beside bare ray casting in turn."""
    config: PhantomConfig = film_of(config_from(settings), frames)
    start = time.monotonic()
    phantom = Phantom(config)
    build = time.monotonic() - start
    script = write_script(phantom)
    every_core = RayCaster(phantom.colon.vertices, phantom.colon.triangles)
    rates: dict[str, list[float]] = {label: [], "ray casting alone": []}
    for _ in range(runs):
        rates[label].append(filmed(phantom, script))
        rates["ray casting alone"].append(cast_only(every_core, phantom, script.world_from_camera))
    ratios = [ours / theirs for ours, theirs in zip(*rates.values(), strict=True)]
    size = f"{config.camera.width}x{config.camera.height}, {len(phantom.colon.triangles)} triangles"
    for name, values in rates.items():
        print(f"{name:24} {shown(spread(values), '.1f')} frames/s ({runs} runs of {frames} frames, {size})")
    print(f"ratio {np.median(ratios):.2f}; building the colon took {build:.1f} s", flush=True)
    figures: dict[str, Any] = {name: spread(values) for name, values in rates.items()}
    return figures | {"ratio": spread(ratios), "build_s": build, "frames": frames, "size": size}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--frames", type=int, default=240)


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Without events, and with all of them."""
    appearance = {name: completed for name, completed in EVERYTHING.items() if name != "events"}
    kinds = {"full appearance": appearance, "and all five events": EVERYTHING}
    runs, frames = arguments.runs, arguments.frames
    return {"figures": {label: measure_film(label, settings, runs, frames) for label, settings in kinds.items()}}
