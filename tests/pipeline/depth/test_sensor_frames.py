"""Depth images of other frames than those that are used are refused, whatever the film announces."""

from types import SimpleNamespace

import numpy as np
import pytest

from haustra.core.errors import HaustraError
from pipeline.depth.sensor.sensor_scale import check_frames


def test_depth_of_other_frames_is_refused():
    used = np.arange(30, 60)
    for numbers in (range(4), range(1000, 1030)):
        sensor = SimpleNamespace(files=dict.fromkeys(numbers), stereo=False)
        told = f"of frames {min(numbers)} to {max(numbers)}, and frames 30 to 59 are used"
        with pytest.raises(HaustraError, match=told):
            check_frames(sensor, used)
    check_frames(SimpleNamespace(files=dict.fromkeys(range(40)), stereo=False), used)
    check_frames(SimpleNamespace(files={}, stereo=True), used)
    check_frames(None, used)
