"""Reasons not to trust a run: the one list that `metrics.json`, report, terminal, batch and viewer show."""

import re
from collections.abc import Iterable, Sequence
from typing import Any

from pipeline.surface.fusion_stage import Surface


def reasons_for_doubt(
    of_stages: Iterable[str], surfaces: Sequence[Surface], submaps: Sequence[dict[str, Any]]
) -> list[str]:
    """Every reason once: a lens that the film does not fix first, then what stages found, what surfaces contradict.

    submaps: their records in `metrics.json`, with "camera" and "contradicted_keyframes".
    """
    lens = [submap["camera"]["trust"] for submap in submaps]
    of_lens = [text for text in lens if "trust" in text]
    of_scale = _of_each_kind(surface.scale.doubt for surface in surfaces)
    of_clock = _of_each_kind(surface.scale.clock_doubt for surface in surfaces)
    of_depth = [
        f"submap {number}: {left_out(submap['contradicted_keyframes'])}"
        for number, submap in enumerate(submaps)
        if submap["contradicted_keyframes"]
    ]
    return list(dict.fromkeys([*of_lens, *of_stages, *of_scale, *of_clock, *of_depth]))


def _of_each_kind(doubts: Iterable[str]) -> list[str]:
    """The first of those that differ in their figures alone, as the same sensor's of several submaps do."""
    first = {re.sub(r"[\d.]+", "", doubt): doubt for doubt in reversed([doubt for doubt in doubts if doubt])}
    return list(reversed(first.values()))


def left_out(frames: Sequence[int]) -> str:
    """Which keyframes took no part in the surface, since their neighbours contradict them."""
    if not frames:
        return "no keyframe: none is contradicted by its neighbours in most of its pixels"
    return f"keyframes {', '.join(map(str, frames))}: their neighbours contradict their depth in most pixels"
