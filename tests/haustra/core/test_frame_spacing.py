"""Frames chosen by motion lie as far apart as asked, and closer where the whole film holds too few of them."""

import numpy as np
import pytest

from haustra.core.frame_spacing import CLOSER, LEAST_FRAMES, MOST_ROUNDS, closer_where_few


def film(motion_of_a_frame, frames=400):
    """What chooses frames of a film with an even motion, and the motions that it was asked for."""
    asked = []

    def choose(motion):
        asked.append(motion)
        return np.arange(0, frames, max(1, int(np.ceil(motion / motion_of_a_frame))))

    return choose, asked


def test_enough_frames_are_left_as_they_are():
    choose, asked = film(motion_of_a_frame=0.5)
    assert closer_where_few(choose, 4.0).tolist() == list(range(0, 400, 8))
    assert asked == [4.0]


def test_where_the_camera_hardly_moves_they_lie_closer():
    choose, asked = film(motion_of_a_frame=0.1)
    assert len(closer_where_few(choose, 4.0)) >= LEAST_FRAMES
    assert asked == pytest.approx(4.0 * CLOSER ** np.arange(len(asked)))
    assert len(choose(asked[-2])) < LEAST_FRAMES  # no closer than it takes


@pytest.mark.parametrize("motion", [0.0, 1e-4])
def test_a_camera_that_stands_still_has_no_more_for_it(motion):
    choose, asked = film(motion_of_a_frame=motion or 1e-12)
    assert len(closer_where_few(choose, 4.0)) == 1
    assert len(asked) == 1 + MOST_ROUNDS
