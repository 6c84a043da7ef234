"""A map adjusted again, with nearly the same lens: what held it before is asked first."""

import copy

import numpy as np
import pytest

from haustra.core.progress import SilentProgress
from pipeline.mapping import final_adjustment
from pipeline.mapping.final_adjustment import adjust_maps, adjust_to_features, widest_narrow
from pipeline.matching.sift_cache import SiftCache
from tests.helpers.tubes.textured_tube import MASK, camera_at, polished, render, run

IMAGES = [render(camera_at(k)) for k in range(20)]


@pytest.fixture(scope="module")
def finished():
    return polished(run(IMAGES)[0])[0]


def test_features_narrower_than_those_that_held_the_map_before_are_not_asked_alone(finished, monkeypatch):
    features = SiftCache(lambda frame: (IMAGES[frame], MASK))
    taking_part, adjust = [], final_adjustment.adjust_all
    monkeypatch.setattr(final_adjustment, "adjust_all", lambda *a: taking_part.append(int(a[3].sum())) or adjust(*a))

    def adjusted(before):
        return adjust_maps([copy.deepcopy(finished)], features, SilentProgress(), before=before)

    narrow = widest_narrow(MASK.shape[1])
    assert adjusted(None) == adjusted([None]) == adjusted([narrow]) == [narrow]
    assert adjusted([np.inf]) == [np.inf]
    assert taking_part[0] == taking_part[1] == taking_part[2] < taking_part[3]


def test_where_those_fail_too_a_few_keyframes_may_part_by_narrow_features_as_ever(finished, monkeypatch):
    asked, narrow = [], widest_narrow(MASK.shape[1])
    monkeypatch.setattr(final_adjustment, "_adjusted", lambda *a: asked.append((a[4], a[3])))
    features = SiftCache(lambda frame: (IMAGES[frame], MASK))
    every = [(False, narrow), (False, np.inf), (True, narrow), (True, np.inf)]
    for least, tried in ((0.0, every), (narrow, every), (np.inf, every[1:])):
        asked.clear()
        assert adjust_to_features(copy.deepcopy(finished), features, least=least) is None
        assert asked == tried
