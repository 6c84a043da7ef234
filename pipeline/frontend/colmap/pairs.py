"""Which images COLMAP matches, those first without which there is no map: matching may have to end before the last."""

from pathlib import Path
from typing import Any

import cv2  # noqa: F401 - before pycolmap, as in the worker
import numpy as np
import pycolmap


def sequential_pairs(names: list[str], overlap: int) -> list[tuple[str, str]]:
    """Each image with the `overlap` after it, and with two at twice and four times that distance.

    The far pairs give slow passages a baseline and keep the rotation from drifting. Pairs of all images at one distance
    follow each other: of neighbours, then each time twice as far up to twice the overlap, then the others.
    """
    distances = [*range(1, overlap + 1), 2 * overlap, 4 * overlap]
    first = [distance for distance in distances if distance & (distance - 1) == 0 and distance <= 2 * overlap]
    ordered = first + [distance for distance in distances if distance not in first]
    return [(names[i], names[i + distance]) for distance in ordered for i in range(len(names) - distance)]


def loops_to_try(job: dict[str, Any]) -> list[tuple[str, str]]:
    """Pairs of images that look alike, beyond the overlap, from the features in the job's database."""
    from pipeline.matching.place_recognition import loop_pairs  # half a second to load; nothing else needs it

    with pycolmap.Database.open(Path(job["database"])) as db:
        ids = {image.name: image.image_id for image in db.read_all_images()}
        descriptors = [np.asarray(db.read_descriptors(ids[name]).data) for name in job["images"]]
    found = loop_pairs(
        descriptors,
        job["loop_stride"],
        job["loop_neighbours"],
        min_gap=4 * job["overlap"] + 1,
        seed=job["seed"],
    )
    return [(job["images"][a], job["images"][b]) for a, b in found]
