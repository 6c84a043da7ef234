"""Where the picture ends, off the axis: against the lens's own formula and the shapes that processors cut."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haustra.core.camera import Camera
from haustra.core.ray_table import RayTable
from pipeline.depth.rectification import make_rectifier
from pipeline.surface.coverage_stage import half_field_of_view
from reconstruction.coverage.centreline import NotATube

SIZE = 200
LENS = Camera("PINHOLE", SIZE, SIZE, (100.0, 100.0, 100.0, 100.0), True)
FISHEYE = Camera("OPENCV_FISHEYE", SIZE, SIZE, (96.0, 96.0, 100.0, 100.0, -0.02, 0.0, 0.0, 0.0), True)
PIXEL_DEG = 0.6  # what a pixel of these lenses subtends on the axis
ACROSS = 1.06  # by how much farther than a corner its sides reach within three degrees around the axis


def whole():
    return np.full((SIZE, SIZE), 255, np.uint8)


def measured(camera, content, widest_deg=120.0):
    return half_field_of_view(RayTable(camera), make_rectifier(camera, widest_deg).camera, content)


def distance_from_axis():
    """(H,W) of the pixels' middles, px."""
    offset = np.arange(SIZE) + 0.5 - SIZE / 2
    return np.hypot(offset[:, None], offset[None])


@settings(max_examples=30, deadline=None)
@given(st.integers(20, 70), st.integers(20, 70))
def test_text_in_a_corner_ends_the_picture_where_it_is_nearest_to_the_axis(width, height):
    content = whole()
    content[:height, :width] = 0
    nearest = np.hypot(100 - width, 100 - height)
    low, high = (np.degrees(np.arctan(min(reach * nearest, 100) / 100)) for reach in (1, ACROSS))
    assert low - 2 * PIXEL_DEG < measured(LENS, content) < high + PIXEL_DEG


@pytest.mark.parametrize("radius", [40, 70, 96])
def test_a_disc_ends_at_its_own_angle_through_a_fisheye(radius):
    content = np.where(distance_from_axis() < radius, 255, 0).astype(np.uint8)
    theta = np.linspace(0, 1.5, 100_000)
    by_lens = np.degrees(np.interp(radius, 96 * theta * (1 - 0.02 * theta**2), theta))
    assert measured(FISHEYE, content) == pytest.approx(by_lens, abs=2 * PIXEL_DEG)


def test_without_border_it_is_half_of_the_narrower_field_of_view():
    camera = Camera("PINHOLE", SIZE, 120, (100.0, 100.0, 100.0, 60.0), True)
    found = measured(camera, np.full((120, SIZE), 255, np.uint8))
    assert found == pytest.approx(min(camera.field_of_view()) / 2, abs=2 * PIXEL_DEG)


def test_what_is_missing_inside_the_picture_does_not_end_it():
    content = whole()
    content[80:96, 40:160] = 0  # a line of text across it
    assert measured(LENS, content) == measured(LENS, whole())


def test_a_thin_line_from_the_border_does_not_end_it():
    content = whole()
    content[96:100, :60] = 0  # text beside the picture, whose last letters lie over it
    assert measured(LENS, content) > 43
    content[80:120, :60] = 0  # a block of it does
    assert measured(LENS, content) < 25


def test_depth_that_is_completed_in_a_narrower_picture_ends_it():
    pinhole = make_rectifier(FISHEYE, 80.0).camera
    assert measured(FISHEYE, whole(), 80.0) == pytest.approx(min(pinhole.field_of_view()) / 2)
    assert measured(FISHEYE, whole()) > measured(FISHEYE, whole(), 80.0) + 5


@pytest.mark.parametrize("columns", [slice(0, 100), slice(0, 200), slice(60, 140)])
def test_a_picture_that_ends_at_its_axis_is_not_judged(columns):
    content = whole()
    content[:, columns] = 0
    with pytest.raises(NotATube, match="off its axis"):
        measured(LENS, content)


def test_off_centre_it_is_the_nearer_side():
    camera = Camera("PINHOLE", SIZE, SIZE, (100.0, 100.0, 70.0, 110.0), True)
    assert measured(camera, whole()) == pytest.approx(np.degrees(np.arctan(0.7)), abs=PIXEL_DEG)
