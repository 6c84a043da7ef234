"""Training frames without video: many colons, few views each, in memory-mappable arrays.

    python -m haustra.phantom.dataset.shards OUT --frames 3000 --size 192 --seed 0 --workers 2

writes shards.json, the arguments, and

images.npy      uint8 (N,H,W,3) RGB
depths.npy      float16 (N,H,W) z-depth mm, 0 = none; in steps of 0.06 mm from 64 mm on
intrinsics.npy  float32 (N,4) fx fy cx cy, pixel centres at half integers; paraxial where the lens is distorted
lens.npy        uint8 (N): 0 PINHOLE, 1 OPENCV, 2 OPENCV_FISHEYE
distortion.npy  float32 (N,4), the lens' further parameters
colon.npy       int32 (N) which colon, to split by mesh

Colon k depends on the seed and k alone, so the bytes do not depend on the number of workers.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.lib.format import open_memmap

from haustra.phantom.config import PhantomConfig
from haustra.phantom.dataset.randomise import random_camera, random_imaging, randomised
from haustra.phantom.dataset.scenes import SCENES, film_of, scene_config
from haustra.phantom.imaging.camera import MODELS
from haustra.phantom.imaging.render import Phantom
from haustra.phantom.imaging.sensor import Sensor
from haustra.phantom.motion.viewpoints import random_viewpoint

FRAMES_PER_COLON = 20  # a colon takes as long to make as about 40 frames


@dataclass(frozen=True)
class ShardPlan:
    """Training frames to render, and the folder they go to."""

    folder: Path
    frames: int
    size: int  # px, square
    seed: int
    scene: str | None = None  # named scene with varying seed; None draws anatomy, appearance and lens at random

    @property
    def colons(self) -> int:
        """Number of colons that the frames need."""
        return -(-self.frames // FRAMES_PER_COLON)

    def about(self) -> dict[str, int | str | None]:
        """What shards.json says."""
        own = {"frames": self.frames, "size": self.size, "seed": self.seed, "scene": self.scene}
        return own | {"colons": self.colons}

    def arrays(self) -> dict[str, tuple[type, tuple[int, ...]]]:
        """Type and shape of each array by its file's stem."""
        count, size = self.frames, self.size
        return {
            "images": (np.uint8, (count, size, size, 3)),
            "depths": (np.float16, (count, size, size)),
            "intrinsics": (np.float32, (count, 4)),
            "lens": (np.uint8, (count,)),
            "distortion": (np.float32, (count, 4)),
            "colon": (np.int32, (count,)),
        }


def write_shards(plan: ShardPlan, workers: int = 1, progress: Callable[[int, int], None] | None = None) -> None:
    """Render all frames of the plan, but for those that a stopped call of the same plan has rendered;
    `progress(done, total)` counts frames."""
    finished = _begin(plan)
    done = sum(min(FRAMES_PER_COLON, plan.frames - colon * FRAMES_PER_COLON) for colon in finished)
    tasks = [(plan, colon) for colon in range(plan.colons) if colon not in finished]
    context = multiprocessing.get_context("spawn")  # Open3D's threads do not survive a fork
    with context.Pool(workers) as pool:
        for colon, count in pool.imap_unordered(_render_colon, tasks):
            done += count
            finished.add(colon)
            _unfinished(plan).write_text(json.dumps({"plan": plan.about(), "finished": sorted(finished)}))
            if progress:
                progress(done, plan.frames)
    (plan.folder / "shards.json").write_text(json.dumps(plan.about(), indent=1) + "\n")
    _unfinished(plan).unlink(missing_ok=True)


def _unfinished(plan: ShardPlan) -> Path:
    """Which colons are rendered, while some are not."""
    return plan.folder / "unfinished.json"


def _begin(plan: ShardPlan) -> set[int]:
    """Colons that an earlier call of this plan has rendered; where there are none, arrays are made."""
    plan.folder.mkdir(parents=True, exist_ok=True)
    if _unfinished(plan).exists():
        before = json.loads(_unfinished(plan).read_text())
        if before["plan"] == plan.about():
            return set(before["finished"])
    for name, (dtype, shape) in plan.arrays().items():
        open_memmap(plan.folder / f"{name}.npy", mode="w+", dtype=dtype, shape=shape).flush()
    return set()


def _render_colon(task: tuple[ShardPlan, int]) -> tuple[int, int]:
    """Fill one colon's slice of the arrays; returns the colon and its number of frames."""
    plan, colon = task
    cv2.setNumThreads(1)
    rng = np.random.default_rng([plan.seed, colon])
    phantom = Phantom(_config(plan, rng), threads=1)
    arrays = {name: np.load(plan.folder / f"{name}.npy", mmap_mode="r+") for name in plan.arrays()}
    first = colon * FRAMES_PER_COLON
    last = min(first + FRAMES_PER_COLON, plan.frames)
    for index in range(first, last):
        # Each frame of a random phantom has a light and a lens of its own.
        view = phantom if plan.scene else phantom.seen_through(random_imaging(rng), random_camera(rng, plan.size))
        world_from_camera = random_viewpoint(view.colon, view.caster, view.rays, rng)
        drift = world_from_camera.copy()
        drift[:3, 3] += rng.normal(0.0, 0.5, 3)  # where motion blur points
        sensor = Sensor(view.config.imaging, plan.size, plan.size, seed=view.config.seed + index)
        frame = view.shoot(world_from_camera, drift, sensor, rng)
        arrays["images"][index] = frame.image
        arrays["depths"][index] = frame.depth
        arrays["intrinsics"][index] = view.camera.params[:4]
        arrays["lens"][index] = MODELS.index(view.camera.model)
        arrays["distortion"][index] = (*view.camera.params[4:], 0, 0, 0, 0)[:4]
        arrays["colon"][index] = colon
    return colon, last - first


def _config(plan: ShardPlan, rng: np.random.Generator) -> PhantomConfig:
    """Config of one colon: random, or the named scene with a random seed."""
    if plan.scene is None:
        return randomised(rng, plan.size)
    return film_of(scene_config(plan.scene, int(rng.integers(2**31))), size=plan.size)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Render training frames of random phantoms into .npy arrays.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--frames", type=int, default=3000)
    parser.add_argument("--size", type=int, default=192, help="side of the square image, px")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--scene", choices=SCENES, help="default: everything at random")
    args = parser.parse_args()
    plan = ShardPlan(args.folder, args.frames, args.size, args.seed, args.scene)
    write_shards(plan, args.workers, lambda done, total: print(f"{done}/{total} frames", flush=True))


if __name__ == "__main__":
    main()
