"""The second front end under `auto`: its time, its lens, and where its models lie."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from haustra.core.progress import SilentProgress
from pipeline.config import Config
from pipeline.frontend import automatic, second_opinion
from pipeline.frontend.base import FrontEndResult
from pipeline.frontend.registry import FRONT_ENDS
from pipeline.frontend.second_opinion import (
    known_lens,
)
from pipeline.input.endomapper_scopes import colonoscope_across
from pipeline.matching.sift_cache import SiftCache
from tests.helpers.candidates import DARK, GOOD, Given, many_frames, map_of
from tests.helpers.tubes.textured_tube import CAMERA

SETTINGS = Config().front_end_settings
NO_FEATURES = SiftCache(None)  # nobody asks for any


class Clockwork:
    """A clock that the front ends move on, and one front end of each kind that takes its time by it."""

    def __init__(self, monkeypatch, first_s, found, second, second_s_a_frame=0.0):
        self.now, self.told, self.lines = 100.0, [], []
        monkeypatch.setattr(automatic.time, "monotonic", lambda: self.now)
        self.root, self.forgotten = Path("/nowhere"), 0
        monkeypatch.setattr(automatic, "candidates_of", lambda mapper, *_: found[mapper])
        monkeypatch.setattr(automatic, "with_doubts", lambda maps, *_: maps)

        def run_first(*_):
            self.now += first_s
            return FrontEndResult({"odometry": []})

        def run_second(frames, features, settings, *_):
            self.told.append((frames.index.tolist(), settings.deadline))
            self.now += second_s_a_frame * len(frames.index)
            return second()

        monkeypatch.setitem(FRONT_ENDS, "odometry", SimpleNamespace(run=run_first))
        monkeypatch.setitem(FRONT_ENDS, "sfm", SimpleNamespace(run=run_second))

    def run(self, count, settings=SETTINGS, camera=CAMERA):
        progress = SilentProgress()
        progress.log = self.lines.append
        workspace = SimpleNamespace(log=self.root, forget_features=self._forget)
        frames = replace(many_frames(count), camera=camera)
        return automatic.run_front_ends(
            automatic.FrontEndJob(NO_FEATURES, settings, workspace, progress), "auto", frames
        )

    def _forget(self):
        self.forgotten += 1


@pytest.mark.parametrize("share", [1.0, 0.5, 0.0])
def test_the_second_opinion_gets_its_share_of_the_time_that_the_first_took(monkeypatch, share):
    found = {"odometry": [map_of(range(60)), map_of(range(60, 100), 0.5)], "global": [map_of(range(50, 100))]}
    clock = Clockwork(monkeypatch, 400.0, found, lambda: FrontEndResult({"global": []}))
    results, _ = clock.run(100, SETTINGS.model_copy(update={"second_opinion": share}))
    if share == 0:
        assert clock.told == []
        return
    ((index, deadline),) = clock.told
    assert index == list(range(50, 100))  # the sure map's frames are not asked again, but for the margin
    assert deadline == pytest.approx(500.0 + 400.0 * share)
    assert f"for {400 * share:.0f} s at most" in clock.lines[0]
    posed = [len(c.submap.frames) for c in results["sfm"].candidates["global"]]
    assert posed == [60, 50]
    assert results["sfm"].in_parts


def in_two_stretches(monkeypatch, tmp_path, second, first_s, s_a_frame):
    """A film of 400 frames, of which the first front end leaves 100 to 150 and 200 to 300 in doubt; COLMAP can map 200
    of them in its time."""
    monkeypatch.setattr(second_opinion, "FEW_FRAMES", 200)
    found = {"odometry": [map_of(range(100)), map_of(range(150, 200)), map_of(range(300, 400))]}
    found["odometry"].append(map_of(range(210, 240), 0.5))
    clock = Clockwork(monkeypatch, first_s, found, second, s_a_frame)
    clock.root = tmp_path
    return clock, found


def placed(root, frames):
    """A map of COLMAP whose model lies where the next run would overwrite it."""
    (root / "global" / "0").mkdir(parents=True)
    return replace(map_of(frames, mapper="global"), folder=root / "global" / "0")


def test_each_stretch_is_mapped_by_itself_and_keeps_its_model(monkeypatch, tmp_path):
    parts = iter([range(90, 160), range(190, 310)])

    def second():
        assert clock.forgotten == len(clock.told), "features are another stretch's"
        found["global"] = [placed(tmp_path, next(parts))]
        return FrontEndResult({"global": []})

    clock, found = in_two_stretches(monkeypatch, tmp_path, second, 90.0, 0.1)
    results, failure = clock.run(400)
    assert failure is None
    assert [(index[0], index[-1] + 1) for index, _ in clock.told] == [(90, 160), (190, 310)]
    maps = results["sfm"].candidates["global"]
    assert results["sfm"].in_parts
    assert sorted(len(one.submap.frames) for one in maps) == [50, 70, 100, 100, 120]
    assert sum(one.check.frames for one in maps) == 400, "margins count once"
    assert all(one.folder.is_dir() for one in maps if one.mapper == "global")
    assert len({one.folder for one in maps if one.mapper == "global"}) == 2


def test_a_stretch_for_which_the_time_left_is_too_short_is_not_begun(monkeypatch, tmp_path):
    def second():
        found["global"] = [placed(tmp_path, range(90, 160))]
        return FrontEndResult({"global": []})

    clock, found = in_two_stretches(monkeypatch, tmp_path, second, 90.0, 0.5)  # 35 s for 70 frames, 60 s for 120
    results, failure = clock.run(400)
    assert failure is None
    assert [len(index) for index, _ in clock.told] == [70]
    assert clock.lines[-1] == "the time left is too short for 1 stretch of 120 frames and more"
    maps = results["sfm"].candidates["global"]
    assert sorted(len(one.submap.frames) for one in maps) == [30, 50, 70, 100, 100], "the other stretch's map stays"


@pytest.mark.parametrize(("share", "asked"), [(0.06, []), (0.07, [13]), (0.18, [13, 21]), (0.94, [36, 61])])
def test_stretches_that_colmap_cannot_map_in_its_time_are_thinned_or_not_begun(monkeypatch, tmp_path, share, asked):
    """Of 70 and 120 frames, by every second or sixth of them; whatever the clock says."""
    clock, _ = in_two_stretches(monkeypatch, tmp_path, lambda: FrontEndResult({}), 40.0, 0.0)
    results, failure = clock.run(400, SETTINGS.model_copy(update={"second_opinion": share}))
    assert [len(index) for index, _ in clock.told] == asked
    assert failure is None
    assert (clock.lines[-1] == "sfm found no map; those of odometry stay") == bool(asked)
    if not asked:
        assert list(results) == ["odometry"]
        assert clock.lines[-1].endswith(
            "is not run for comparison: even every 6th of the 70 frames of the shortest stretch in doubt is more than "
            "the 12 that it can map in its time (second_opinion 0.06); --front-end sfm runs it on the whole film"
        )


@pytest.mark.parametrize(("count", "every"), [(30, 1), (120, 1), (199, 2), (700, 6), (730, None)])
def test_a_short_film_that_is_in_doubt_as_a_whole_gets_a_second_opinion(monkeypatch, count, every):
    """However quick odometry was: as it does where odometry finds nothing at all."""
    clock = Clockwork(monkeypatch, 2.0, {"odometry": [DARK]}, lambda: FrontEndResult({}))
    clock.run(count)
    if every is None:
        assert clock.told == []
        return
    ((index, deadline),) = clock.told
    assert index == sorted({*range(0, count, every), count - 1})
    assert deadline == pytest.approx(100.0 + 2.0 + 90.0 - 0.04 * (count - len(index)))


def test_where_maps_that_are_probably_wrong_are_too_long_only_the_rest_is_asked(monkeypatch):
    doubtful = replace(map_of(range(800)), doubt=SimpleNamespace(probability=0.6))
    clock = Clockwork(monkeypatch, 2.0, {"odometry": [doubtful]}, lambda: FrontEndResult({}))
    results, _ = clock.run(1000)
    ((index, _),) = clock.told
    assert index == [*range(790, 1000, 2), 999]
    assert results["odometry"].candidates["odometry"] == [doubtful]


def test_a_stretch_that_the_second_front_end_maps_worse_keeps_the_first_ones_map(monkeypatch, tmp_path):
    parts = iter([range(90, 160), range(190, 195)])

    def second():
        found["global"] = [replace(map_of(next(parts), mapper="global"), folder=tmp_path / "global" / "0")]
        found["global"][0].folder.mkdir(parents=True)
        return FrontEndResult({"global": []})

    clock, found = in_two_stretches(monkeypatch, tmp_path, second, 90.0, 0.1)
    found["odometry"][-1] = map_of(range(205, 240))  # too short to be sure, and nothing speaks against it
    results, _ = clock.run(400)
    kept = results["sfm"].candidates["global"]
    assert sorted((one.mapper, len(one.submap.frames)) for one in kept)[0] == ("global", 70)
    assert ("odometry", 35) in [(one.mapper, len(one.submap.frames)) for one in kept]


GUESS = replace(CAMERA, trusted=False)


def with_focal(of, focal, sigma):
    """The map with a lens that was refined to a focal length."""
    submap = SimpleNamespace(frames=of.submap.frames, camera_params=(focal, *CAMERA.params[1:]), camera_sigma=sigma)
    return replace(of, submap=submap)


def test_a_lens_is_known_that_was_given_or_that_a_sure_map_determines(monkeypatch):
    monkeypatch.setattr(second_opinion, "refined_camera", lambda camera, s: replace(camera, params=s.camera_params))
    frames = replace(many_frames(100), camera=GUESS)
    camera, sigma = known_lens([with_focal(GOOD, 140.0, (1.0,))], frames)
    assert (camera.params[0], camera.trusted, sigma) == (140.0, True, (1.0,))
    assert known_lens([with_focal(GOOD, 140.0, (20.0,))], frames) is None
    assert known_lens([with_focal(DARK, 140.0, (1.0,))], frames) is None
    assert known_lens([DARK], many_frames(100)) == (CAMERA, ())


def test_a_second_front_end_takes_over_the_lens_that_maps_in_doubt_have_where_it_began_with_distortion(monkeypatch):
    monkeypatch.setattr(second_opinion, "refined_camera", lambda camera, s: replace(camera, params=s.camera_params))
    mean = colonoscope_across(CAMERA.width, CAMERA.height, (0, 0, CAMERA.width, CAMERA.height))
    frames = replace(many_frames(100), camera=mean)
    camera, sigma = known_lens([with_focal(DARK, 140.0, (1.0,))], frames)
    assert (camera.params[0], camera.trusted, sigma) == (140.0, True, (1.0,))
    assert known_lens([], frames) is None


@pytest.mark.parametrize("known", [True, False])
def test_stretches_are_mapped_with_the_lens_that_is_known_or_at_once(monkeypatch, tmp_path, known):
    monkeypatch.setattr(second_opinion, "refined_camera", lambda camera, s: replace(camera, params=s.camera_params))
    parts, cameras = iter([range(90, 160), range(190, 310)]), []

    def second():
        one = placed(tmp_path, next(parts)) if known else map_of(range(90, 310), mapper="global")
        found["global"] = [replace(one, submap=Given(one.submap.frames))]
        return FrontEndResult({"global": []})

    clock, found = in_two_stretches(monkeypatch, tmp_path, second, 90.0, 0.1)
    found["odometry"] = [with_focal(one, 140.0, (1.0,) if known else (20.0,)) for one in found["odometry"]]
    run = FRONT_ENDS["sfm"].run
    told = SimpleNamespace(run=lambda frames, *rest: cameras.append(frames.camera) or run(frames, *rest))
    monkeypatch.setitem(FRONT_ENDS, "sfm", told)
    results, _ = clock.run(400, camera=GUESS)
    assert [len(index) for index, _ in clock.told] == ([70, 120] if known else [190])
    assert {camera.params[0] for camera in cameras} == {140.0 if known else GUESS.params[0]}
    theirs = [one for one in results["sfm"].candidates["global"] if one.mapper == "global"]
    assert all(one.submap.camera_sigma == ((1.0,) if known else ()) for one in theirs)
    if known:
        assert all((one.folder / "camera_sigma.txt").read_text() == "1.0" for one in theirs)


def test_where_the_first_found_nothing_the_second_has_all_the_time(monkeypatch):
    found = {"odometry": [], "global": [map_of(range(100))]}
    clock = Clockwork(monkeypatch, 40.0, found, lambda: FrontEndResult({"global": []}))
    results, _ = clock.run(100)
    assert clock.told == [(list(range(100)), None)]
    assert not results["sfm"].in_parts


def test_an_interrupt_of_the_second_opinion_keeps_the_first(monkeypatch):
    def interrupted():
        raise KeyboardInterrupt

    clock = Clockwork(monkeypatch, 5.0, {"odometry": [DARK]}, interrupted)
    results, failure = clock.run(100)
    assert list(results) == ["odometry"]
    assert failure is None
    assert "interrupted" in clock.lines[-1]
