"""Which images COLMAP matches, those first without which there is no map: matching may have to end before the last."""

from typing import Any

from numpy.typing import NDArray


def sequential_pairs(names: list[str], overlap: int) -> list[tuple[str, str]]:
    """Each image with the `overlap` after it, and with two at twice and four times that distance.

    The far pairs give slow passages a baseline and keep the rotation from drifting. Pairs of all images at one distance
    follow each other: of neighbours, then each time twice as far up to twice the overlap, then the others.
    """
    distances = [*range(1, overlap + 1), 2 * overlap, 4 * overlap]
    first = [distance for distance in distances if distance & (distance - 1) == 0 and distance <= 2 * overlap]
    ordered = first + [distance for distance in distances if distance not in first]
    return [(names[i], names[i + distance]) for distance in ordered for i in range(len(names) - distance)]


def loops_to_try(job: dict[str, Any], descriptors: list[NDArray[Any]]) -> list[tuple[str, str]]:
    """Pairs of the job's images that look alike, beyond the overlap, by each image's descriptors (N,128)."""
    from pipeline.matching.place_recognition import loop_pairs  # half a second to load; nothing else needs it

    found = loop_pairs(
        descriptors,
        job["loop_stride"],
        job["loop_neighbours"],
        min_gap=4 * job["overlap"] + 1,
        seed=job["seed"],
    )
    return [(job["images"][a], job["images"][b]) for a, b in found]
