"""Which maps are kept of two front ends: the better ones of each stretch that was in doubt, and parts of the first
one's where these pose nothing.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from pipeline.frontend.scoring import MAX_INCONSISTENT, MIN_JUDGED, Candidate, best_mapper, part_of, score, sure_of
from pipeline.frontend.second_opinion import ByMapper, Opinion, runs_of
from pipeline.mapping.map_doubt import PROBABLE
from pipeline.mapping.submap import MIN_FRAMES


def joined(first: list[Candidate], total: int, opinions: list[Opinion]) -> ByMapper:
    """Maps of the whole film of `total` frames, by mapper of the second front end, most frames first.

    Maps of the first one that are sure, or in no stretch, stay. Of one stretch, each mapper's maps take the place of
    the other ones. Of several, those of a mapper or the first front end's, whichever are better on the frames in doubt;
    stretches that a map of the first one spans are decided together. None takes the place of others that are expected
    to pose more frames rightly: a large map in doubt is worth more than a few frames. Nothing where the first front
    end's are better everywhere.
    """
    sure = [id(one) for one in sure_of(first, total)]
    groups = _groups([one for one in first if id(one) not in sure], opinions)
    in_doubt = [id(one) for maps, _ in groups for one in maps]
    kept = [one for one in first if id(one) not in in_doubt]
    if len(opinions) == 1:
        ((maps, (opinion,)),) = groups
        expected = partial(_poses_rightly, frames=opinion.stretch.doubtful)
        usable = {mapper: _usable(opinion, mapper, kept) for mapper in opinion.candidates}
        return {mapper: _distinct(kept, of) if expected(of) >= expected(maps) else [] for mapper, of in usable.items()}
    second: list[Candidate] = []
    for maps, about in groups:
        doubtful = np.concatenate([opinion.stretch.doubtful for opinion in about])
        theirs = [one for opinion in about for one in _best(opinion, kept)]
        better = _worth(theirs, doubtful) > _worth(maps, doubtful)
        if better and _poses_rightly(theirs, doubtful) >= _poses_rightly(maps, doubtful):
            second += theirs
        else:
            kept = kept + maps
    names = " and ".join(dict.fromkeys(one.mapper for one in second))
    return {names: _distinct(kept, second)} if second else {}


def with_rests(
    kept: list[Candidate], first: list[Candidate], image_of: Callable[[int], NDArray[np.uint8]]
) -> list[Candidate]:
    """Maps that are kept, and of the first front end's maps that gave way to them the parts that pose frames that none
    of them does, most frames first.

    A part has at least `MIN_JUDGED` frames one after the other, the light does not contradict it, its map is more
    probably right than wrong, and has the others' lens: one film has one. image_of: picture (H,W,3) of a frame."""
    claimed = {int(frame) for one in kept for frame in one.submap.frames}
    lenses, found = {one.submap.camera_params for one in kept}, list(kept)
    for one in sorted(first, key=lambda one: -one.check.frames):
        is_kept, has_their_lens = any(one is other for other in kept), lenses <= {one.submap.camera_params}
        if is_kept or not has_their_lens or one.wrong_probability >= PROBABLE:
            continue
        part = part_of(one, _unclaimed(one.submap.frames, claimed), image_of)
        if part is not None and part.check.inconsistent_share <= MAX_INCONSISTENT:
            found.append(part)
            claimed |= {int(frame) for frame in part.submap.frames}
    return sorted(found, key=lambda one: -one.check.frames)


def _unclaimed(frames: NDArray[np.int64], claimed: set[int]) -> NDArray[np.int64]:
    """Of a map's frames those that are not claimed, in stretches of at least `MIN_JUDGED` without a claimed one."""
    free = np.array([int(frame) not in claimed for frame in frames])
    return np.concatenate([np.zeros(0, np.int64), *(frames[slice(*run)] for run in runs_of(free, MIN_JUDGED))])


def _groups(maps: list[Candidate], opinions: list[Opinion]) -> list[tuple[list[Candidate], list[Opinion]]]:
    """Stretches that a map of the first front end spans together, with all its maps that have frames in them."""
    groups: list[tuple[list[Candidate], list[Opinion]]] = []
    for opinion in opinions:
        inside = [one for one in maps if np.isin(one.submap.frames, opinion.stretch.doubtful).any()]
        about = [opinion]
        for group in [g for g in groups if any(one is other for one in g[0] for other in inside)]:
            groups.remove(group)
            inside += [one for one in group[0] if not any(one is other for other in inside)]
            about += group[1]
        groups.append((inside, about))
    return groups


def _best(opinion: Opinion, kept: list[Candidate]) -> list[Candidate]:
    """The better mapper's maps of one stretch."""
    usable = {mapper: _usable(opinion, mapper, kept) for mapper in opinion.candidates}
    return usable[best_mapper(usable, len(opinion.stretch.frames.index))] if usable else []


def _usable(opinion: Opinion, mapper: str, kept: list[Candidate]) -> list[Candidate]:
    """Maps with some of the frames in doubt; beside others, none that the light contradicts."""
    return [
        one
        for one in opinion.candidates[mapper]
        if _inside([one], opinion.stretch.doubtful)[0] >= MIN_FRAMES
        and not (kept and one.check.inconsistent_share > MAX_INCONSISTENT)
    ]


def _worth(maps: list[Candidate], frames: NDArray[np.int64]) -> float:
    """Score by these frames alone."""
    inside = zip(maps, _inside(maps, frames), strict=True)
    return score([replace(one, check=replace(one.check, frames=count)) for one, count in inside], len(frames))


def _poses_rightly(maps: list[Candidate], frames: NDArray[np.int64]) -> float:
    """How many of these frames they are expected to pose rightly; a map that the light contradicts, and of which no
    probability was computed, none."""
    dark = [one.doubt is None and one.check.inconsistent_share > MAX_INCONSISTENT for one in maps]
    right = [0.0 if is_dark else 1 - one.wrong_probability for one, is_dark in zip(maps, dark, strict=True)]
    return float(np.dot(right, _inside(maps, frames)))


def _inside(maps: list[Candidate], frames: NDArray[np.int64]) -> list[int]:
    """How many of these frames each of them poses."""
    return [int(np.isin(one.submap.frames, frames).sum()) for one in maps]


def _distinct(kept: list[Candidate], second: Iterable[Candidate]) -> list[Candidate]:
    """Both, most frames first. A frame that two have counts for the first front end's, or the larger one of two of the
    second; a map of the second to which too few are left goes."""
    claimed = {int(frame) for one in kept for frame in one.submap.frames}
    found = list(kept)
    for one in sorted(second, key=lambda one: -one.check.frames):
        own = {int(frame) for frame in one.submap.frames} - claimed
        if len(own) >= MIN_FRAMES:
            found.append(replace(one, check=replace(one.check, frames=len(own))))
            claimed |= own
    return sorted(found, key=lambda one: -one.check.frames)
