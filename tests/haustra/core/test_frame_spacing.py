"""Frames chosen by motion lie as far apart as asked, and closer where the whole film holds too few of them."""

import numpy as np
import pytest

from haustra.core.frame_spacing import HALVINGS, LEAST_FRAMES, closer_where_few, least_of_each


def film(motion_of_a_frame, frames=400):
    """What chooses frames of a film with an even motion, and the motions that it was asked for."""
    asked = []

    def choose(motion):
        asked.append(motion)
        return np.arange(0, frames, max(1, int(np.ceil(motion / motion_of_a_frame))))

    return choose, asked


def test_enough_frames_are_left_as_they_are():
    choose, asked = film(motion_of_a_frame=0.5)
    assert closer_where_few(choose, 4.0, 400, LEAST_FRAMES).tolist() == list(range(0, 400, 8))
    assert asked == [4.0]


@pytest.mark.parametrize("motion_of_a_frame", [0.05, 0.1])
def test_where_the_camera_hardly_moves_there_are_so_many_and_no_more(motion_of_a_frame):
    choose, asked = film(motion_of_a_frame)
    rows = closer_where_few(choose, 4.0, 400, LEAST_FRAMES)
    before, last = asked[-2:]
    assert len(rows) == LEAST_FRAMES
    assert (np.diff(rows) > 0).all()
    assert set(rows.tolist()) <= set(choose(last).tolist()) | set(choose(4.0).tolist())
    assert len(choose(before)) < LEAST_FRAMES  # no closer than it takes


def test_no_frame_of_a_part_that_moves_is_given_up_for_one_that_hovers():
    place = np.concatenate([np.linspace(0, 20, 300), 20 + np.arange(1, 20) * 4.0])

    def choose(motion):
        chosen = [0]
        for row in range(1, len(place)):
            if place[row] - place[chosen[-1]] >= motion:
                chosen.append(row)
        return np.array(chosen)

    rows = closer_where_few(choose, 4.0, len(place), LEAST_FRAMES)
    assert len(choose(4.0)) < len(rows) == LEAST_FRAMES
    assert set(choose(4.0)) <= set(rows)


def test_a_camera_that_stands_still_has_no_more_for_it():
    choose, asked = film(motion_of_a_frame=1e-4)
    assert closer_where_few(choose, 4.0, 400, LEAST_FRAMES).tolist() == [0]
    assert len(asked) == 1 + HALVINGS


def test_nobody_looks_for_more_than_there_are():
    choose, asked = film(motion_of_a_frame=0.5, frames=12)
    assert closer_where_few(choose, 0.5, 12, LEAST_FRAMES).tolist() == list(range(12))
    assert asked == [0.5]


def test_submaps_share_what_the_film_has_at_least():
    assert least_of_each([200]) == [LEAST_FRAMES]
    assert least_of_each([300, 100, 4]) == [24, 8, 1]
