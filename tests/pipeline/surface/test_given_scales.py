"""What gives millimetres to a run whose poses are given and whose sensor saw too little."""

from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.config import load_config
from pipeline.mapping.submap import Submap
from pipeline.surface import given_scales


@pytest.mark.parametrize("has_sensor", [False, True])
def test_a_sensor_that_saw_too_little_takes_nothing_from_the_poses(monkeypatch, has_sensor):
    flat = np.zeros((0, 2))
    submap = Submap(
        np.arange(3), np.tile(np.eye(4), (3, 1, 1)), np.zeros((0, 3)), np.zeros(0), flat.astype(int), flat, (1.0,) * 4
    )
    monkeypatch.setattr(given_scales, "scene_unit", lambda _: 30.0)
    monkeypatch.setattr(given_scales, "scene_units", lambda _: [30.0])
    monkeypatch.setattr(given_scales, "open_sensor", lambda *_: SimpleNamespace() if has_sensor else None)
    monkeypatch.setattr(given_scales, "sensor_scale", lambda *_: None)
    config = load_config(None, poses={"file": "poses.txt", "mm_per_unit": 2.0})
    frames = SimpleNamespace(camera=SimpleNamespace(width=320))
    (scale,) = given_scales.given_scales(config.poses, frames, [SimpleNamespace(submap=submap)], None)
    assert (scale.factor, scale.unit) == (60.0, "mm")
    assert ("the sensor saw too few" in scale.doubt) == has_sensor
