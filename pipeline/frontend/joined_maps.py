"""Which maps are kept of two front ends: the better ones of each stretch that was in doubt, and the other ones where
these pose nothing.
"""

from collections.abc import Iterable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from pipeline.frontend.scoring import MAX_INCONSISTENT, MIN_JUDGED, Candidate, best_mapper, part_of, score, sure_of
from pipeline.frontend.second_opinion import ByMapper, Opinion
from pipeline.mapping.submap import MIN_FRAMES


def joined(first: list[Candidate], total: int, opinions: list[Opinion]) -> ByMapper:
    """Maps of the whole film of `total` frames, by mapper of the second front end, most frames first.

    Maps of the first one that are sure, or in no stretch, stay. Of one stretch, each mapper's maps take the place of
    the other ones. Of several, those of a mapper or the first front end's, whichever are better on the frames in doubt;
    stretches that a map of the first one spans are decided together. None takes the place of others that are expected
    to pose more frames rightly: a large map in doubt is worth more than a few frames. Of the first front end's maps
    that give way, what poses frames that no other does stays. Nothing where they are better everywhere.
    """
    sure = [id(one) for one in sure_of(first, total)]
    groups = _groups([one for one in first if id(one) not in sure], opinions)
    in_doubt = [id(one) for maps, _ in groups for one in maps]
    kept = [one for one in first if id(one) not in in_doubt]
    if len(opinions) == 1:
        ((maps, (opinion,)),) = groups
        expected = partial(_poses_rightly, frames=opinion.stretch.doubtful)
        usable = {mapper: _usable(opinion, mapper, kept) for mapper in opinion.candidates}
        return {
            mapper: _with_rests(_distinct(kept, of), maps) if expected(of) >= expected(maps) else []
            for mapper, of in usable.items()
        }
    second: list[Candidate] = []
    given_up: list[Candidate] = []
    for maps, about in groups:
        doubtful = np.concatenate([opinion.stretch.doubtful for opinion in about])
        theirs = [one for opinion in about for one in _best(opinion, kept)]
        better = _worth(theirs, doubtful) > _worth(maps, doubtful)
        if better and _poses_rightly(theirs, doubtful) >= _poses_rightly(maps, doubtful):
            second += theirs
            given_up += maps
        else:
            kept = kept + maps
    names = " and ".join(dict.fromkeys(one.mapper for one in second))
    return {names: _with_rests(_distinct(kept, second), given_up)} if second else {}


def _with_rests(found: list[Candidate], given_up: list[Candidate]) -> list[Candidate]:
    """Both, most frames first; of the maps that were given up only what poses frames that no other has, if that is long
    enough to be judged, the light does not contradict the map, and it has the others' lens: one film has one."""
    claimed = {int(frame) for one in found for frame in one.submap.frames}
    lenses, rests = {one.submap.camera_params for one in found}, []
    for one in sorted(given_up, key=lambda one: -one.check.frames):
        own = {int(frame) for frame in one.submap.frames} - claimed
        agrees = one.check.inconsistent_share <= MAX_INCONSISTENT and lenses <= {one.submap.camera_params}
        if agrees and len(own) >= MIN_JUDGED:
            rests.append(one if len(own) == len(one.submap.frames) else part_of(one, own))
            claimed |= own
    return sorted([*found, *rests], key=lambda one: -one.check.frames)


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
    right = [0.0 if is_dark else 1 - one.wrong for one, is_dark in zip(maps, dark, strict=True)]
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
