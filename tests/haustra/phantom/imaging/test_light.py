"""The phantom's light and sensor, term by term against plane geometry, closed forms and plain statistics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haustra.phantom.config import AnatomyConfig, CameraConfig, ImagingConfig, PhantomConfig
from haustra.phantom.imaging.render import Phantom
from haustra.phantom.imaging.sensor import smear
from haustra.phantom.imaging.shading import shade
from tests.helpers.phantom_oracles import BARE, COLOURLESS, first_hits
from tests.helpers.tiny_phantom import corners_of, pixel_direction

SIZE = 96
FOLDED = PhantomConfig(
    seed=2,
    anatomy=AnatomyConfig(
        length_mm=80.0, radius_mm=12.0, fold_depth_mm=5.0, fold_spacing_mm=18.0, edge_mm=2.0, polyps=0, flexures=0
    ),
    appearance=COLOURLESS,
    imaging=BARE,
    camera=CameraConfig(width=SIZE, height=SIZE),
)


@pytest.fixture(scope="module")
def folded() -> Phantom:
    return Phantom(FOLDED, threads=1)


def axial_pose(phantom: Phantom) -> np.ndarray:
    centre, axes = phantom.colon.line.at(np.array(25.0))
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3], world_from_camera[:3, 3] = axes, centre
    return world_from_camera


def radiance_at(
    points: Sequence[tuple[float, float, float]],
    imaging: ImagingConfig,
    normal: tuple[float, float, float] = (0.0, 0.0, -1.0),
    albedo: float = 1.0,
    lit: float = 1.0,
) -> np.ndarray:
    """Radiance (N,3) of a few wall points that all face the same way."""
    row = np.array([points], np.float32)
    normals = np.broadcast_to(np.array(normal, np.float32), row.shape).copy()
    free = np.full((imaging.lights, 1, len(points)), lit, np.float32)
    return shade(row, normals, np.full_like(row, albedo), np.ones(row.shape[:2], np.float32), free, imaging)[0]


SPOTS = [(0.0, 0.0, 12.0), (5.0, -3.0, 20.0), (-14.0, 9.0, 31.0), (2.0, 8.0, 7.0)]


def test_a_frontal_plane_darkens_with_the_square_of_its_distance() -> None:
    got = radiance_at([(0, 0, 10), (0, 0, 20), (0, 0, 40)], BARE)
    np.testing.assert_allclose(got, np.array([[6.25], [1.5625], [0.390625]]) * np.ones(3), rtol=1e-5)


@pytest.mark.parametrize("roll", [0.0, 30.0, 250.0])
def test_an_offset_light_obeys_lambert_from_where_it_is(roll: float) -> None:
    """A plane z = d under a light at l: (25/r)^2 d/r with r the distance to the light."""
    at = 4.0 * np.cos(np.radians(roll)), 4.0 * np.sin(np.radians(roll))
    got = radiance_at(SPOTS, replace(BARE, light_offset_mm=4.0, light_roll_deg=roll))[:, 0]
    wanted = [625.0 * z / ((x - at[0]) ** 2 + (y - at[1]) ** 2 + z * z) ** 1.5 for x, y, z in SPOTS]
    np.testing.assert_allclose(got, wanted, rtol=1e-5)


def test_a_second_eye_sees_the_wall_as_bright_as_the_first_under_the_same_lamps() -> None:
    """Matte wall has one radiance for all eyes, wherever these are: what stereo matching rests on."""
    first = radiance_at(SPOTS, replace(BARE, light_offset_mm=3.0, lights=2))
    beside = [(x - 4.0, y, z) for x, y, z in SPOTS]
    second = radiance_at(beside, replace(BARE, light_offset_mm=3.0, lights=2, light_shift_mm=-4.0))
    np.testing.assert_allclose(second, first, rtol=1e-5)


def test_two_lights_stand_opposite_and_share_the_power() -> None:
    got = radiance_at(SPOTS, replace(BARE, light_offset_mm=4.0, lights=2))[:, 0]
    wanted = [
        np.mean([625.0 * z / ((x - side) ** 2 + y * y + z * z) ** 1.5 for side in (4.0, -4.0)]) for x, y, z in SPOTS
    ]
    np.testing.assert_allclose(got, wanted, rtol=1e-5)


@pytest.mark.parametrize("lobe", [0.2, 1.7, 4.0])
def test_the_lobe_is_a_power_of_the_cosine_to_the_lights_axis(lobe: float) -> None:
    even, shaped = (radiance_at(SPOTS, replace(BARE, light_offset_mm=4.0, light_lobe=e))[:, 0] for e in (0.0, lobe))
    cosine = [np.cos(np.arctan2(np.hypot(x - 4.0, y), z)) for x, y, z in SPOTS]
    np.testing.assert_allclose(shaped / even, np.power(cosine, lobe), rtol=1e-4)


@pytest.mark.parametrize(("tilt", "roll"), [(8.0, 0.0), (8.0, 90.0), (25.0, 200.0)])
def test_a_tilted_lobe_is_brightest_along_its_own_axis(tilt: float, roll: float) -> None:
    """The axis as two rotations make it: of the optical axis about y, then about z."""
    even, shaped = (
        radiance_at(SPOTS, replace(BARE, light_lobe=e, lobe_tilt_deg=tilt, lobe_roll_deg=roll))[:, 0]
        for e in (0.0, 2.5)
    )
    axis = Rotation.from_euler("yz", (tilt, roll), degrees=True).apply([0, 0, 1])
    cosine = [np.dot(axis, spot) / np.linalg.norm(spot) for spot in SPOTS]
    np.testing.assert_allclose(shaped / even, np.maximum(cosine, 0) ** 2.5, rtol=1e-4)


@pytest.mark.parametrize("turn", [0.0, 60.0, 90.0, 100.0, 130.0])
def test_wrapped_light_reaches_beyond_the_terminator(turn: float) -> None:
    normal = (float(np.sin(np.radians(turn))), 0.0, -float(np.cos(np.radians(turn))))
    for wrap in (0.0, 0.3):
        wanted = max((np.cos(np.radians(turn)) + wrap) / (1 + wrap), 0.0)
        got = radiance_at([(0, 0, 25)], replace(BARE, wrap=wrap), normal)
        np.testing.assert_allclose(got, wanted, atol=2e-6)


def test_ambient_light_ignores_shadow_and_is_reflected_twice() -> None:
    imaging = replace(BARE, ambient=0.16)
    near, far = radiance_at([(0, 0, 5), (0, 0, 45)], imaging, lit=0.0)[:, 0]
    assert near / far == pytest.approx(5.0, rel=1e-5)  # 1 / (distance + 5 mm)
    pale = radiance_at([(0, 0, 5)], imaging, albedo=0.5, lit=0.0)[0, 0]
    assert near / pale == pytest.approx(4.0, rel=1e-5)
    sharp = radiance_at([(0, 0, 5)], BARE, lit=1.0)[0, 0]
    assert radiance_at([(0, 0, 5)], imaging, lit=1.0)[0, 0] == pytest.approx(sharp + near, rel=1e-5)


def test_light_has_its_colour_and_arrives_as_far_as_it_is_let() -> None:
    got = radiance_at([(0, 0, 25)], replace(BARE, light_colour=(1.0, 0.8, 0.5)), albedo=0.5, lit=0.5)
    np.testing.assert_allclose(got[0], [0.25, 0.2, 0.125], rtol=1e-5)


@pytest.mark.parametrize("shininess", [20.0, 90.0, 300.0])
def test_a_glint_sits_at_the_mirror_point_and_falls_off_as_blinn_has_it(shininess: float) -> None:
    """In the plane of lens, light and wall, the half vector's tilt is the mean of the two directions' tilts."""
    offset, depth = 6.0, 18.0
    x = np.linspace(-6, 12, 181)
    plain = replace(BARE, light_offset_mm=offset)
    shiny = replace(plain, specular=0.4, shininess=shininess)
    spots = [(float(place), 0.0, depth) for place in x]
    glint = (radiance_at(spots, shiny) - radiance_at(spots, plain))[:, 0].astype(float)
    tilt = 0.5 * (np.arctan((offset - x) / depth) + np.arctan(-x / depth))
    arriving = 625.0 / ((offset - x) ** 2 + depth**2)
    wanted = arriving * 0.4 * shininess / 60 * np.cos(tilt) ** shininess
    np.testing.assert_allclose(glint, wanted, atol=2e-5 * wanted.max(), rtol=2e-4)
    assert x[(glint / arriving).argmax()] == pytest.approx(offset / 2)


@pytest.fixture(scope="module")
def shadow(folded: Phantom) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Part of the light that arrives in the picture; by brute force, True where a straight line leads to the light;
    and where light would arrive without shadows. All (H,W)."""
    roll, offset = 65.0, 5.0
    light = offset * np.array([np.cos(np.radians(roll)), np.sin(np.radians(roll)), 0.0])
    imaging = replace(BARE, light_offset_mm=offset, light_roll_deg=roll)
    world_from_camera = axial_pose(folded)
    off, on = (
        folded.seen_through(replace(imaging, shadows=s), FOLDED.camera).look(world_from_camera, world_from_camera)
        for s in (False, True)
    )
    at = np.array([off.wall[pixel] * pixel_direction(folded.camera, *pixel) for pixel in np.ndindex(SIZE, SIZE)])
    lamp = world_from_camera[:3, :3] @ light + world_from_camera[:3, 3]
    reach, _ = first_hits(lamp, (at - light) @ world_from_camera[:3, :3].T, corners_of(folded))
    bright = off.radiance[..., 0] > 1e-3
    bright[:8] = bright[-8:] = bright[:, :8] = bright[:, -8:] = False  # what happens beyond the border is not known
    return on.radiance[..., 0] / np.maximum(off.radiance[..., 0], 1e-9), (reach > 0.99).reshape(SIZE, SIZE), bright


def test_shadows_fall_where_no_straight_line_leads_to_the_light(
    shadow: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    part, free, bright = shadow
    far = np.ones((13, 13))  # the penumbra is some pixels wide: judge only well inside light or shadow
    sure_lit, sure_dark = (cv2.erode(mask.astype(np.uint8), far).astype(bool) & bright for mask in (free, ~free))
    assert sure_lit.sum() > 1200
    assert sure_dark.sum() > 60
    np.testing.assert_allclose(part[sure_lit], 1.0, atol=0.03)
    assert part[sure_dark].max() < 0.03


def test_shadows_are_not_displaced(shadow: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    """Least squares for the shift (px) that takes the softened brute-force shadow to the picture's."""
    part, free, bright = shadow
    soft = cv2.GaussianBlur(free.astype(float), (0, 0), 2.4)
    down, right = np.gradient(soft)
    shift = np.linalg.lstsq(np.stack([right[bright], down[bright]], axis=1), (soft - part)[bright], rcond=None)[0]
    assert np.abs(shift).max() < 0.2


def test_the_whole_picture_is_lambert_about_the_light(folded: Phantom) -> None:
    """The rendered wall, not just `shade`: reflectance (25/r)^2 cosine, with the normals of the wall's triangles."""
    light = np.array([0.0, 5.0, 0.0])
    view = folded.seen_through(replace(BARE, light_offset_mm=5.0, light_roll_deg=90.0), FOLDED.camera)
    world_from_camera = axial_pose(folded)
    look = view.look(world_from_camera, world_from_camera)
    corners = corners_of(folded)
    ratio, wrong_side = [], []
    for row, column in np.random.default_rng(0).integers(0, SIZE, (1500, 2)):
        triangle = corners[look.triangle[row, column]]
        normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0]) @ world_from_camera[:3, :3]
        at = look.wall[row, column] * pixel_direction(view.camera, row, column)
        wanted = []
        for lamp in (light, -light):
            r = np.linalg.norm(lamp - at)
            wanted.append(0.5 * (25 / r) ** 2 * max(normal @ (lamp - at) / r / np.linalg.norm(normal), 0))
        if min(wanted) > 0.02 and look.triangle[row, column] >= 0:
            ratio.append(look.radiance[row, column, 0] / wanted[0])
            wrong_side.append(look.radiance[row, column, 0] / wanted[1])
    spread = [np.median(np.abs(np.log(np.maximum(values, 1e-6)))) for values in (ratio, wrong_side)]
    assert len(ratio) > 500
    assert np.median(ratio) == pytest.approx(1.0, abs=0.03)
    assert spread[0] < 0.12  # shading is smooth over facets
    assert spread[1] > 2 * spread[0]


def dot(row: int, column: int) -> np.ndarray:
    light = np.zeros((81, 81, 3), np.float32)
    light[row, column] = 1.0
    return light


WAYS = pytest.mark.parametrize(("flow", "shutter"), [((12.0, 0.0), 1.0), ((0.0, -16.0), 0.5), ((10.0, 18.0), 0.7)])


def smeared_dot(flow: tuple[float, float], shutter: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Weights of a smeared dot's pixels, how far they lie (px) along and across its way, and the way's length."""
    light = np.zeros((81, 81, 3), np.float32)
    light[40, 36] = 1.0
    blurred = smear(light, np.tile(np.array(flow, np.float32), (81, 81, 1)), shutter)[..., 1].astype(float)
    row, column = np.nonzero(blurred)
    way = shutter * np.hypot(*flow)
    x, y = shutter * np.array(flow) / way
    return blurred[row, column], (column - 36) * x + (row - 40) * y, (row - 40) * x - (column - 36) * y, way


@WAYS
def test_a_dot_is_smeared_along_its_way_about_where_it_is(flow: tuple[float, float], shutter: float) -> None:
    weight, along, across, way = smeared_dot(flow, shutter)
    assert weight.sum() == pytest.approx(1.0, abs=1e-4)
    assert weight @ along == pytest.approx(0, abs=0.02)  # half before, half after the pose's time
    assert weight @ across == pytest.approx(0, abs=0.02)
    assert np.abs(across).max() < 1.5
    assert along.max() == pytest.approx(way / 2, abs=1.5)
    assert along.min() == pytest.approx(-way / 2, abs=1.5)


@WAYS
def test_a_smeared_dot_has_the_deviation_of_an_even_line(flow: tuple[float, float], shutter: float) -> None:
    weight, along, _, way = smeared_dot(flow, shutter)
    assert np.sqrt(12 * (weight @ along**2)) == pytest.approx(way, rel=0.1)


STEP = np.tile(np.where(np.arange(81) < 40, 0.0, 1.0).astype(np.float32)[None, :, None], (81, 1, 3))


@pytest.mark.parametrize(("flow", "shutter"), [((20.0, 0.0), 0.8), ((8.0, 11.0), 1.0)])
def test_a_step_becomes_a_ramp_as_long_as_the_way(flow: tuple[float, float], shutter: float) -> None:
    profile = smear(STEP, np.tile(np.array(flow, np.float32), (81, 81, 1)), shutter)[40, :, 0].astype(float)
    ramp = np.clip((np.arange(81) - 39.5) / (shutter * flow[0]) + 0.5, 0, 1)
    assert np.abs(profile - ramp).max() < 0.13


def test_a_step_keeps_its_middle_and_is_sharp_to_those_who_move_along_it() -> None:
    across, along = (
        smear(STEP, np.tile(np.array(way, np.float32), (81, 81, 1)), 1.0) for way in ((14.0, 5.0), (0.0, 30.0))
    )
    assert (across - STEP)[20:60].sum(axis=1) == pytest.approx(0, abs=1e-3)
    np.testing.assert_array_equal(along[20:60], STEP[20:60])


def test_motion_blur_is_the_mean_of_what_is_seen_while_the_shutter_is_open() -> None:
    colourful = replace(COLOURLESS, mottle=0.3, tree_vessels=1.0, trees_per_cm2=1.0)
    phantom = Phantom(replace(FOLDED, appearance=colourful, anatomy=replace(FOLDED.anatomy, fold_depth_mm=1.0)), 1)
    world_from_camera, step = axial_pose(phantom), np.eye(4)
    turn = np.radians(6.0)
    step[:3, :3] = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]

    def seen(shutter: float, part: float = 0.0) -> np.ndarray:
        turned = np.eye(4)
        turned[:3, :3] = cv2.Rodrigues(np.array([0, part * turn, 0]))[0]
        imaging = replace(BARE, shutter=shutter)
        at = world_from_camera @ turned
        radiance = phantom.seen_through(imaging, FOLDED.camera).look(at, at @ step).radiance
        return radiance[12:-12, 12:-12].astype(float)

    def mean_over(begin: float, end: float) -> np.ndarray:
        parts = np.linspace(begin, end, 25)
        return np.mean([seen(0.0, float(0.5 * (a + b))) for a, b in pairwise(parts)], axis=0)

    blurred, sharp, wanted, late = seen(0.8), seen(0.0), mean_over(-0.4, 0.4), mean_over(0.0, 0.8)
    error, without, shifted = (np.abs(blurred - other).mean() for other in (wanted, sharp, late))
    assert error < 0.35 * without
    assert error < 0.35 * shifted
