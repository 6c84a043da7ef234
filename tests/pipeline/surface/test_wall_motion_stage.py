"""What is found of the front end's submaps is said of the submaps that are fused."""

from dataclasses import asdict

import numpy as np

from haustra.core.progress import SilentProgress
from pipeline.frontend.wall_motion import WallMotion
from pipeline.surface import wall_motion_stage as stage
from pipeline.surface.wall_motion_stage import load_motion


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
    order, asked = iter([*found[:2], WallMotion(True, 0.5)]), []
    monkeypatch.setattr(stage, "measure_motion", lambda frames, submap: asked.append(submap) or next(order))

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
    made = stage.wall_motion_stage(None, completed, submaps, folder, SilentProgress())
    assert made == found == load_motion(folder)
    assert asked == submaps  # with the front end's own points
    assert folder.result("motion")["submaps"][0] == asdict(found[0])
