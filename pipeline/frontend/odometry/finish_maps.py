"""Maps that tracking left, made into the front end's result: the last adjustments, merging, submaps."""

import copy

from haustra.core.progress import Progress
from pipeline.frontend.base import MIN_FRAMES
from pipeline.mapping.final_adjustment import adjust_to_features
from pipeline.mapping.local_map import DepthAt, LocalMap, TrackKind
from pipeline.mapping.map_adjustment import adjust_all
from pipeline.mapping.metric_map import make_metric
from pipeline.mapping.submap import Submap
from pipeline.mapping.submap_merging import merge_maps
from pipeline.mapping.submap_of_map import to_submap
from pipeline.matching.sift import FindFeatures


def make_all_metric(maps: list[LocalMap], depth_at: DepthAt, progress: Progress) -> None:
    """Maps that a sensor saw enough of in millimetres, to be adjusted with what it measured."""
    scales = [make_metric(local_map, depth_at) for local_map in maps if local_map.depth_at is None]
    if None in scales:
        progress.log(f"the sensor saw too few points of {scales.count(None)} of {len(maps)} maps to adjust them by it")


def adjust_maps(
    maps: list[LocalMap], find: FindFeatures, progress: Progress, changed: bool = False
) -> list[float | None]:
    """As `refit_maps`; and those that features do not hold to their corners, `changed` or not (see `adjust_all`)."""
    held = refit_maps(maps, find, progress)
    for local_map in (m for m, by in zip(maps, held, strict=True) if by is None):
        with progress.bar("adjusting to corners", None) as advance:
            adjust_all(local_map, changed, advance)
    return held


def refit_maps(maps: list[LocalMap], find: FindFeatures, progress: Progress) -> list[float | None]:
    """Every map moved to where its own features have it. Those that they do not hold (None) stay, and a sentence says
    so; of the others, how wide the features were at most."""
    if not maps:
        return []
    held = []
    for local_map in maps:
        with progress.bar("adjusting to features", None) as advance:
            held.append(adjust_to_features(local_map, find, advance))
    for local_map in (m for m, by in zip(maps, held, strict=True) if by is None):
        first, last = local_map.keyframes[0].frame, local_map.keyframes[-1].frame
        progress.log(
            f"frames {first} to {last}: too few features to adjust the map by; its scale may bend along the path"
        )
    return held


def join_maps(
    maps: list[LocalMap], held: list[float | None], find: FindFeatures, seed: int, progress: Progress
) -> tuple[list[LocalMap], int]:
    """Maps that saw the same places made one, and how many joins there were.

    After each map has been straightened by its features: a bent map's scale at the seam is not that of the rest. Where
    the features that held the parts do not hold the whole, the parts are given back: a seam must not cost them that.
    """
    if len(maps) < 2:
        return maps, 0
    apart = copy.deepcopy(maps)
    with progress.bar("merging submaps", None):
        merged = merge_maps(maps, find, seed)
    result: list[LocalMap] = []
    for whole in merged:
        if len(whole.members) == 1:
            result.append(whole.map)
            continue
        (by,) = refit_maps([whole.map], find, progress)
        before = [width for width in (held[number] for number in whole.members) if width is not None]
        if len(before) < len(whole.members):  # one of them never was
            if by is None:
                adjust_all(whole.map, changed=True)
        elif by is None or by > max(before):
            progress.log(f"{len(before)} submaps stay separate: they match, but too few features agree after merging")
            result += [apart[number] for number in whole.members]
            continue
        result.append(whole.map)
    return result, len(maps) - len(result)


def submaps_of(
    maps: list[LocalMap], params: tuple[float, ...], sigma: tuple[float, ...] = (), kind: TrackKind | None = None
) -> list[Submap]:
    """Of the maps that are long enough, most frames first; kind: see `to_submap`."""
    found = [to_submap(local_map, params, sigma, kind) for local_map in maps]
    kept = [submap for submap in found if submap is not None and len(submap.frames) >= MIN_FRAMES]
    return sorted(kept, key=lambda submap: -len(submap.frames))
