"""What is loaded in the background: the same network, its error where it is asked for, and nothing left changed."""

import gc
import sys

import numpy as np
import pytest

from completion.inference.completer import DepthCompleter
from haustra.core.errors import HaustraError
from pipeline.depth import preparation
from pipeline.depth.preparation import Preparation


def test_the_network_is_the_one_that_is_named(monkeypatch) -> None:
    monkeypatch.setattr(preparation, "LIBRARIES", ("json",))
    before = sys.getswitchinterval(), gc.get_threshold()
    sparse = np.zeros((64, 64), np.float32)
    sparse[4::12, 4::12] = 2.0
    rgb = np.random.default_rng(0).integers(0, 255, (64, 64, 3)).astype(np.uint8)
    with Preparation("mscsa", "cpu", None) as later:
        later.begin(with_network=True)
        assert gc.get_threshold()[0] == preparation.OBJECTS_BETWEEN_SEARCHES
        made = later.completer()(rgb, sparse)
        assert later.completer() is later.completer()
    for one, other in zip(made, DepthCompleter.load("mscsa", "cpu")(rgb, sparse), strict=True):
        np.testing.assert_array_equal(one, other)
    assert (sys.getswitchinterval(), gc.get_threshold()) == before


def test_a_network_that_was_let_go_is_loaded_again_where_it_is_asked_for(monkeypatch) -> None:
    loaded = []
    monkeypatch.setattr(preparation, "LIBRARIES", ())
    monkeypatch.setattr(preparation, "load_completer", lambda *_: loaded.append(object()) or loaded[-1])
    with Preparation("mscsa", "cpu", None) as later:
        later.begin(with_network=True)
        first = later.completer()
        later.forget()
        second = later.completer()
        assert later.completer() is second
    assert loaded == [first, second]


def test_a_network_that_is_not_asked_for_is_not_loaded(monkeypatch) -> None:
    monkeypatch.setattr(preparation, "LIBRARIES", ())
    monkeypatch.setattr(preparation, "load_completer", lambda *_: pytest.fail("nobody asked for it"))
    with Preparation("mscsa", "cpu", None) as later:
        later.begin(with_network=False)


def test_what_does_not_load_is_said_where_it_is_asked_for(monkeypatch) -> None:
    monkeypatch.setattr(preparation, "LIBRARIES", ("no_library_of_this_name",))
    with Preparation("no such model", "cpu", None) as later:
        later.begin(with_network=True)
        with pytest.raises(HaustraError, match="no model 'no such model'"):
            later.completer()
