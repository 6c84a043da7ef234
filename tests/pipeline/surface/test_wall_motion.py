"""The stage's residuals against finite differences, and its word on a submap whose points move."""

from dataclasses import asdict

import numpy as np

from haustra.core.camera import Camera
from haustra.core.progress import SilentProgress
from pipeline.mapping.submap import Submap
from pipeline.surface import wall_motion
from pipeline.surface.wall_motion import WallMotion, load_motion, measure_motion, residuals, sentences

LENS = Camera("OPENCV_FISHEYE", 200, 150, (100.0, 100.0, 100.0, 75.0, -0.02, 0.0, 0.0, 0.0), True)
COUNT, POINTS, RATE = 90, 300, 15.0


class FilmFrames:
    """The lens, and when each frame was."""

    camera = LENS

    def seconds_of_numbers(self, numbers):
        return numbers / RATE


def film(amplitude, noise_px=0.3, count=COUNT):
    """A submap of a camera that goes sideways before a wall 1 away, through which a contraction runs."""
    rng = np.random.default_rng(0)
    wall = np.column_stack([rng.uniform(-0.6, 0.6, (POINTS, 2)), rng.uniform(0.8, 1.2, POINTS)])
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 3] = np.linspace(0, 0.1, count)
    row, point = (a.ravel() for a in np.meshgrid(np.arange(count), np.arange(POINTS), indexing="ij"))
    at = np.exp(-(((wall[point, 1] - 0.2 * (row / RATE - 3)) / 0.2) ** 2))
    moved = wall[point] + amplitude * at[:, None] * np.array([0.8, 0.6, 0.0])
    pixels = LENS.project(moved - poses[row, :3, 3]) + noise_px * rng.standard_normal((len(row), 2))
    observations = np.column_stack([row, point])
    return Submap(np.arange(count), poses, wall, np.zeros(POINTS), observations, pixels, LENS.params)


def test_a_still_film_and_a_moving_one():
    still, moving = (measure_motion(FilmFrames(), film(amplitude)) for amplitude in (0.0, 0.02))
    assert not still.told
    assert moving.told
    assert sentences([still, None, moving])[0].startswith("points of submap 2 miss a still wall")
    assert len(sentences([still, None, moving])) == 1


def test_a_long_film_is_asked_in_pieces(monkeypatch):
    asked = []
    monkeypatch.setattr(wall_motion, "PIECE_S", 2.0)
    monkeypatch.setattr(wall_motion, "held_out_motion", lambda seen: asked.append(np.ptp(seen.seconds)))
    assert measure_motion(FilmFrames(), film(0.0)) is None
    assert len(asked) == 3
    assert max(asked) < 2.0


def test_a_piece_has_no_more_observations_than_fit(monkeypatch):
    asked = []
    monkeypatch.setattr(wall_motion, "MOST_OBSERVATIONS", 5000)
    monkeypatch.setattr(wall_motion, "held_out_motion", lambda seen: asked.append(len(seen.point)))
    measure_motion(FilmFrames(), film(0.0))
    assert 2500 < asked[0] <= 5000


def test_jacobians_are_those_of_finite_differences():
    submap = film(0.0, count=3)
    seconds, mine, step = np.arange(3.0), np.ones(len(submap.observations), bool), 1e-6
    seen = residuals(FilmFrames(), submap, seconds, mine)
    for axis in range(3):
        moved = submap.points + step * np.eye(3)[axis]
        other = residuals(FilmFrames(), Submap(**vars(submap) | {"points": moved}), seconds, mine)
        slope = (other.pixels - seen.pixels) / step
        assert np.allclose(seen.jacobian[:, :, axis], slope, rtol=1e-3, atol=1e-2)


def test_a_right_map_misses_nothing():
    seen = residuals(FilmFrames(), film(0.0, noise_px=0.0, count=3), np.arange(3.0), np.ones(3 * POINTS, bool))
    assert np.abs(seen.pixels).max() < 1e-3


class Folder:
    """A workspace's record of stages."""

    def __init__(self):
        self.results = {}

    def is_done(self, stage):
        return stage in self.results

    def finish(self, stage, **result):
        self.results[stage] = result

    def result(self, stage):
        return self.results[stage]


def test_what_is_recorded_is_read_again_and_runs_of_earlier_versions_have_none(monkeypatch):
    folder, found = Folder(), [WallMotion(True, 0.2), None, None]
    assert load_motion(folder) == []
    order, asked = iter(found[:2]), []
    monkeypatch.setattr(wall_motion, "measure_motion", lambda frames, submap: asked.append(submap) or next(order))

    class Submap:
        def __init__(self, *frames):
            self.frames = np.array(frames)

    class Completed:
        depth_scale = None

        def __init__(self, *frames):
            self.submap = Submap(*frames)

    class Moved(Completed):
        depth_scale = np.ones(3)  # by closed loops: not asked

    completed, submaps = [Completed(0, 1), Completed(2, 3), Moved(4, 5)], [Submap(0, 1), Submap(2, 3), Submap(4, 5)]
    made = wall_motion.wall_motion_stage(FilmFrames(), completed, submaps, folder, SilentProgress())
    assert made == found == load_motion(folder)
    assert asked == submaps[:2]  # with the front end's own points
    assert folder.result("motion")["submaps"][0] == asdict(found[0])
