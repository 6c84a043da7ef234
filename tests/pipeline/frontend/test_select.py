"""`--front-end auto`: odometry, and COLMAP for clips of which odometry's map leaves doubt."""

from types import SimpleNamespace

import numpy as np
import pytest

from haustra.core.errors import HaustraError
from haustra.core.progress import SilentProgress
from pipeline.config import Config
from pipeline.frontend import select as structure
from pipeline.mapping.lighting_check import Evidence

GOOD = (None, Evidence(90, 600, 0.5, 5.0, -0.9, 0.0, 90), None)
DARK = (None, Evidence(90, 600, 0.3, 5.0, -0.2, 0.4, 90), None)


@pytest.fixture
def asked(monkeypatch, tmp_path):
    """Call `_maps` with mappers that find what is given; returns the mappers asked, in order, and the best one."""

    def call(front_end, frames, found):
        asked = []

        def look_up(method):
            asked.append(method)
            return found[method]

        monkeypatch.setattr(structure, "colmap_job", lambda *_: {})
        monkeypatch.setattr(structure, "run_isolated", lambda *_: None)
        monkeypatch.setattr(structure, "map_by_colmap", lambda method, *_: look_up(method))
        monkeypatch.setattr(structure, "_map_by_odometry", lambda *_: look_up("odometry"))
        many = SimpleNamespace(index=np.arange(frames))
        maps = structure._maps(many, Config(front_end=front_end), SimpleNamespace(log=tmp_path), SilentProgress())
        assert list(maps) == asked
        return asked, structure.best_mapper(maps, frames)

    return call


def test_a_good_map_of_odometry_is_enough(asked):
    assert asked("auto", 100, {"odometry": [GOOD]}) == (["odometry"], "odometry")


def test_colmap_is_asked_where_odometry_leaves_doubt(asked):
    assert asked("auto", 100, {"odometry": [DARK], "global": [GOOD]}) == (["odometry", "global"], "global")
    found = {"odometry": [], "global": [], "incremental": [GOOD]}
    assert asked("auto", 100, found) == (["odometry", "global", "incremental"], "incremental")


def test_colmap_is_not_asked_of_a_long_video(asked):
    assert asked("auto", structure.MOST_SFM_FRAMES + 1, {"odometry": [DARK]}) == (["odometry"], "odometry")


def test_a_mapper_that_finds_nothing_does_not_win(asked):
    assert asked("auto", 100, {"odometry": [DARK], "global": [], "incremental": []})[1] == "odometry"


def test_sfm_and_odometry_ask_nobody_else(asked):
    assert asked("sfm", 100, {"global": [DARK], "incremental": []})[0] == ["global", "incremental"]
    assert asked("odometry", 100, {"odometry": []})[0] == ["odometry"]


def test_auto_survives_a_matcher_that_fails(monkeypatch, tmp_path):
    def fail(*_):
        raise HaustraError("features and matches failed")

    def call(front_end):
        monkeypatch.setattr(structure, "colmap_job", lambda *_: {})
        monkeypatch.setattr(structure, "run_isolated", fail)
        monkeypatch.setattr(structure, "_map_by_odometry", lambda *_: [DARK])
        few = SimpleNamespace(index=np.arange(100))
        return structure._maps(few, Config(front_end=front_end), SimpleNamespace(log=tmp_path), SilentProgress())

    assert list(call("auto")) == ["odometry"]
    with pytest.raises(HaustraError, match="failed"):
        call("sfm")


def test_both_mappers_crashing_names_their_logs(tmp_path):
    for method in ("global", "incremental"):
        (tmp_path / f"{method}.failed").touch()
    mapped = {"global": [], "incremental": [], "odometry": []}
    assert "logs are in" in structure._why_no_model(mapped, 100, SimpleNamespace(log=tmp_path))


def test_who_asks_for_sfm_gets_sfm(asked):
    assert asked("sfm", 100, {"global": [], "incremental": [DARK]})[0] == ["global", "incremental"]
    assert asked("sfm", structure.MOST_SFM_FRAMES + 1, {"global": [], "incremental": []})[0][0] == "global"
