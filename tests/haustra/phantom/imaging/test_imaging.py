"""Stool, fluid, villi and the processor's marks, each against an oracle: areas, analytic blur, cv2's own JPEG."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haustra.phantom.anatomy.colon import Colon, build_colon
from haustra.phantom.appearance.coating import GLOSS_FLUID, GLOSS_STOOL, coat, upwards
from haustra.phantom.appearance.texture import SurfaceTexture
from haustra.phantom.config import (
    AnatomyConfig,
    AppearanceConfig,
    CameraConfig,
    ImagingConfig,
    MotionConfig,
    PhantomConfig,
)
from haustra.phantom.dataset.randomise import random_appearance, random_imaging, randomised
from haustra.phantom.imaging.camera import make_camera
from haustra.phantom.imaging.interreflection import bounced
from haustra.phantom.imaging.render import Frame, Phantom
from haustra.phantom.imaging.sensor import Sensor, border_window, coarse_colour, defocus_sigma
from haustra.phantom.imaging.shading import shade
from haustra.phantom.motion.camera_path import plan_camera_path

SIZE = 64
ANATOMY = AnatomyConfig(length_mm=100.0, radius_mm=14.0, fold_depth_mm=4.0, edge_mm=2.0, polyps=0, flexures=0)
PLAIN = AppearanceConfig(texel_mm=0.4, mesh_vessels=0.0, tree_vessels=0.0)
FILM = PhantomConfig(
    seed=5,
    anatomy=ANATOMY,
    appearance=PLAIN,
    imaging=ImagingConfig(noise=0.0),
    camera=CameraConfig(width=SIZE, height=SIZE),
    motion=MotionConfig(frames=2, start=0.5, speed_mm=1.0, wobble_mm=1.0),
)
QUIET = ImagingConfig(noise=0.0, vignette=0.0, blur_px=0.0, gamma=1.0, exposure=0.2)
LUMA = np.array([0.299, 0.587, 0.114])


@pytest.fixture(scope="module")
def colon() -> Colon:
    return build_colon(ANATOMY, seed=5)


@pytest.fixture(scope="module")
def phantom() -> Phantom:
    return Phantom(FILM, threads=1)


def filmed(phantom: Phantom, imaging: ImagingConfig) -> Frame:
    view = phantom.seen_through(imaging, FILM.camera)
    return next(view.film(plan_camera_path(view.colon, view.caster, FILM.motion, FILM.seed)))


def edge(height: int, width: int, left: float, right: float) -> np.ndarray:
    """A step (H,W,3) float32 in the middle."""
    values = np.where(np.arange(width) < width // 2, left, right).astype(np.float32)
    return np.tile(values[None, :, None], (height, 1, 3))


def face_areas(colon: Colon) -> np.ndarray:
    corners = colon.vertices[colon.triangles].astype(float)
    return 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)


def at_faces(texture: SurfaceTexture, colon: Colon) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Reflectance, gloss and normal in the middle of every triangle, as a ray would find them."""
    faces = np.arange(len(colon.triangles), dtype=np.uint32)[None]
    row, column = colon.grid_position(faces, np.full((*faces.shape, 2), 1 / 3, np.float32))
    albedo, gloss, normal = texture.sample(row, column, np.full(faces.shape, 0.01, np.float32))
    return albedo[0], gloss[0], normal[0]


@pytest.mark.parametrize("part", [0.05, 0.3])
def test_stool_covers_the_part_of_the_area_asked_for_and_is_matte(colon: Colon, part: float) -> None:
    texture = SurfaceTexture(colon, replace(PLAIN, stool=part, stool_colour=(0.1, 0.1, 0.9)), seed=5)
    albedo, gloss, _ = at_faces(texture, colon)
    covered, area = gloss < 0.5 * (1 + GLOSS_STOOL), face_areas(colon)
    assert area[covered].sum() / area.sum() == pytest.approx(part, abs=0.1 * part + 0.01)
    assert gloss.min() == pytest.approx(GLOSS_STOOL, abs=1e-3)
    assert gloss.max() == pytest.approx(1.0, abs=1e-3)
    blue = albedo[:, 2] / albedo.sum(axis=1)
    assert blue[gloss < 0.1].min() > 0.7
    assert blue[gloss > 0.99].max() < 0.3


def test_fluid_lies_on_the_low_side_and_shines(colon: Colon) -> None:
    tint = (1.0, 1.0, 0.2)
    wet = SurfaceTexture(colon, replace(PLAIN, fluid=0.2, fluid_colour=tint), seed=5)
    albedo, gloss, normal = at_faces(wet, colon)
    dry_albedo, dry_gloss, dry_normal = at_faces(SurfaceTexture(colon, PLAIN, seed=5), colon)
    covered, area = gloss > 1.5, face_areas(colon)
    assert area[covered].sum() / area.sum() == pytest.approx(0.2, abs=0.03)
    corners = colon.vertices[colon.triangles].astype(float)
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    up = (facing / np.linalg.norm(facing, axis=1, keepdims=True)) @ upwards(5)
    assert np.median(up[covered]) > 0.5  # the floor's inside faces up
    assert (up[covered] > 0).mean() > 0.97
    assert 1.0 <= gloss.min() <= gloss.max() <= GLOSS_FLUID + 1e-3
    np.testing.assert_array_equal(dry_gloss, 1.0)
    np.testing.assert_allclose(albedo[..., :2], dry_albedo[..., :2], atol=1e-6)
    assert ((albedo / dry_albedo)[covered, 2] < 0.81).all()  # a quarter opaque at least: 1 - 0.25 * 0.8
    smooth = facing / np.linalg.norm(facing, axis=1, keepdims=True)
    tilt_wet, tilt_dry = ((1 - (n * smooth).sum(axis=1))[gloss > 2.5].mean() for n in (normal, dry_normal))
    assert tilt_wet < tilt_dry


def test_stool_stands_off_the_wall(colon: Colon) -> None:
    points, normals = np.ascontiguousarray(colon.points), colon.normals
    coating = coat(points, normals, replace(PLAIN, stool=0.2), seed=5)
    assert coating.height_mm[coating.stool == 0].max() == 0.0
    assert 0.1 < coating.height_mm[coating.stool == 1].mean() < 1.0


def test_villi_roughen_the_normals_at_their_own_scale(colon: Colon) -> None:
    still = replace(PLAIN, bump_mm=0.0, texel_mm=0.1)
    velvet = replace(colon, anatomy=replace(ANATOMY, villi_mm=0.3))
    smooth, rough = (at_faces(SurfaceTexture(c, still, seed=5), c)[2] for c in (colon, velvet))
    tilt = np.tan(np.arccos(np.clip((smooth * rough).sum(axis=1), -1, 1)))
    # A height of standard deviation 0.3/4 mm has an rms slope of 2 pi 0.075 / w at wavelength w; texels average some.
    assert 2 * np.pi * 0.075 / 1.5 < np.sqrt((tilt**2).mean()) < 2 * np.pi * 0.075 / 0.4


def test_glints_are_proportional_to_gloss() -> None:
    points, normals = (np.tile(np.float32([0, 0, z]), (1, 3, 1)) for z in (20, -1))
    black, lit = np.zeros_like(points), np.ones((2, 1, 3), np.float32)
    gloss = np.array([[0.05, 1.0, 3.0]], np.float32)
    glint = shade(points, normals, black, gloss, lit, ImagingConfig())[0, :, 1]
    np.testing.assert_allclose(glint / glint[1], gloss[0], rtol=1e-5)
    assert glint[1] > 0


@pytest.mark.parametrize("depth", [12.5, 17.0, 25.0, 60.0, 5.0])
def test_defocus_blurs_an_edge_as_the_lens_formula_says(depth: float) -> None:
    width, asked = 320, 1.5
    imaging = replace(QUIET, focus_mm=25.0, defocus_px=asked, exposure=0.3)
    step = edge(40, width, 0.2, 0.8)
    image = Sensor(imaging, width, 40).expose(step, np.random.default_rng(0), np.full((40, width), depth, np.float32))
    slope = np.maximum(np.diff(image[20, :, 1].astype(float)), 0)
    place = np.arange(len(slope))
    mean = (slope * place).sum() / slope.sum()
    measured = np.sqrt((slope * (place - mean) ** 2).sum() / slope.sum())
    assert measured == pytest.approx(asked * min(abs(1 - 25.0 / depth), 3.0), rel=0.06, abs=0.12)


def test_a_sharp_rim_does_not_glow_into_the_blurred_wall_behind() -> None:
    light, depth = edge(64, 64, 1.0, 0.1), edge(64, 64, 10.0, 100.0)[..., 0]
    imaging = replace(QUIET, focus_mm=10.0, defocus_px=10.0, exposure=0.2)  # 2 px here
    sharp, shown = (Sensor(i, 64, 64).expose(light, np.random.default_rng(0), depth) for i in (QUIET, imaging))
    ratio = shown[32, 34:40, 1] / sharp[32, 50, 1].astype(float)
    assert ratio.max() < 1.5  # a plain Gaussian gives 3.6 two pixels beyond the edge
    np.testing.assert_allclose(shown[32, :31, 1] / sharp[32, :31, 1].astype(float), 1.0, atol=0.12)


def test_unknown_depth_counts_as_far() -> None:
    sigma = defocus_sigma(np.array([0.0, 1e9], np.float32), 25.0, 2.0)
    np.testing.assert_allclose(sigma, 2.0, rtol=1e-5)


def test_sharpening_leaves_a_halo_of_the_analytic_height() -> None:
    width = 320
    step = edge(32, width, 0.1, 0.3)
    plain, edged = (
        Sensor(replace(QUIET, sharpen=s), width, 32).expose(step, np.random.default_rng(0))[16, :, 1].astype(float)
        for s in (0.0, 0.8)
    )
    low, high = plain[10], plain[-10]
    overshoot = (edged.max() - high) / (high - low)
    from_edge = 0.5 * (1 - cv2.getGaussianKernel(15, 1.3)[7, 0])  # half a pixel past an ideal step, by the kernel's sum
    assert overshoot == pytest.approx(0.8 * from_edge, abs=0.02)
    np.testing.assert_allclose(edged[:140], low, atol=0.51)


@given(seed=st.integers(0, 1000), height=st.integers(2, 21), width=st.integers(2, 21))
@settings(max_examples=20, deadline=None)
def test_coarse_colour_keeps_brightness_and_has_one_colour_per_block(seed: int, height: int, width: int) -> None:
    picture = np.random.default_rng(seed).uniform(0.3, 0.7, (height, width, 3)).astype(np.float32)
    coarse = coarse_colour(picture, 2)
    np.testing.assert_allclose(coarse @ LUMA, picture @ LUMA, atol=1e-5)
    colour = coarse - (coarse @ LUMA)[..., None]
    for row, column in np.ndindex(height // 2, width // 2):
        block = np.s_[2 * row : 2 * row + 2, 2 * column : 2 * column + 2]
        before = picture[block] - (picture[block] @ LUMA)[..., None]
        np.testing.assert_allclose(colour[block].reshape(-1, 3), np.tile(before.mean(axis=(0, 1)), (4, 1)), atol=1e-5)


@pytest.mark.parametrize(("quality", "chroma_px"), [(40, 2), (90, 1)])
def test_jpeg_is_opencvs_round_trip(phantom: Phantom, quality: int, chroma_px: int) -> None:
    clean = ImagingConfig(noise=0.0, chroma_px=chroma_px)
    image = filmed(phantom, clean).image
    factor = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420 if chroma_px == 2 else cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, factor]
    data = cv2.imencode(".jpg", image[..., ::-1], options)[1]
    packed = filmed(phantom, replace(clean, jpeg_quality=quality)).image
    np.testing.assert_array_equal(packed, cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1])
    assert (packed != image).any()


@pytest.mark.parametrize("border", ["none", "octagon"])
def test_text_is_outside_the_window_and_the_rest_is_untouched(phantom: Phantom, border: str) -> None:
    clean = ImagingConfig(noise=0.0, border=border, exposure_smoothing=0.0)
    bare, written = filmed(phantom, clean), filmed(phantom, replace(clean, text=True))
    sensor = Sensor(replace(clean, text=True), SIZE, SIZE, FILM.seed)
    changed = np.abs(bare.image.astype(int) - written.image).max(axis=2) > 25  # the gain is metered beside the text
    assert 20 < changed.sum() < 0.15 * changed.size
    assert not (changed & sensor.window).any()
    assert (sensor.window <= border_window(border, SIZE, SIZE)).all()
    assert (written.depth[~sensor.window] == 0).all()
    np.testing.assert_array_equal(written.depth[sensor.window], bare.depth[sensor.window])


def test_the_counter_runs_inside_its_box() -> None:
    sensor = Sensor(replace(QUIET, text=True), 320, 320, seed=4321)
    grey = np.full((320, 320, 3), 0.2, np.float32)
    shown = [sensor.expose(grey, np.random.default_rng(0)) for _ in range(12)]
    assert all((a != b).any() for a, b in pairwise(shown))
    assert all(np.ptp(image[sensor.window]) == 0 for image in shown)


def test_everything_on_is_deterministic_and_all_off_is_as_before(phantom: Phantom) -> None:
    everything = ImagingConfig(
        noise=0.01, defocus_px=1.0, sharpen=0.5, chroma_px=2, jpeg_quality=70, text=True, border="circle"
    )
    np.testing.assert_array_equal(filmed(phantom, everything).image, filmed(phantom, everything).image)
    sensor, light = Sensor(QUIET, 32, 32), np.random.default_rng(0).uniform(0, 1, (32, 32, 3)).astype(np.float32)
    shown = sensor.expose(light.copy(), np.random.default_rng(0), np.full((32, 32), 3.0, np.float32))
    unaware = Sensor(QUIET, 32, 32).expose(light.copy(), np.random.default_rng(0))
    np.testing.assert_array_equal(shown, unaware)  # depth means nothing to a lens that is sharp everywhere
    gain = 0.2 / np.minimum(light[::2, ::2] @ LUMA, 9).mean()
    np.testing.assert_allclose(shown, np.clip(light * gain * 255, 0, 255), atol=1.5)


def test_covering_the_wall_leaves_what_is_under_it(colon: Colon) -> None:
    bare = SurfaceTexture(colon, PLAIN, seed=5)
    spotted = SurfaceTexture(colon, replace(PLAIN, stool=0.1), seed=5)
    one, other = at_faces(bare, colon), at_faces(spotted, colon)
    clean = other[1] == 1.0
    assert clean.mean() > 0.8
    np.testing.assert_allclose(one[0][clean], other[0][clean], atol=1e-6)


def test_every_term_is_off_in_part_of_the_draws() -> None:
    rng = np.random.default_rng(0)
    looks, scopes = [random_appearance(rng) for _ in range(300)], [random_imaging(rng) for _ in range(300)]
    shares = {
        "stool": (np.mean([a.stool > 0 for a in looks]), 0.25),
        "fluid": (np.mean([a.fluid > 0 for a in looks]), 0.25),
        "text": (np.mean([i.text for i in scopes]), 0.1),
        "jpeg": (np.mean([i.jpeg_quality > 0 for i in scopes]), 0.5),
        "chroma": (np.mean([i.chroma_px > 1 for i in scopes]), 0.6),
        "sharpen": (np.mean([i.sharpen > 0 for i in scopes]), 0.4),
        "defocus": (np.mean([i.defocus_px > 0 for i in scopes]), 0.3),
    }
    for name, (share, wanted) in shares.items():
        assert share == pytest.approx(wanted, abs=4 * np.sqrt(wanted * (1 - wanted) / 300)), name
    assert all(40 <= i.jpeg_quality <= 95 for i in scopes if i.jpeg_quality)
    draws = [randomised(np.random.default_rng(k)) for k in range(200)]
    assert {d.anatomy.villi_mm > 0 for d in draws if d.anatomy.scene == "colon"} == {False}
    assert {d.anatomy.collapse > 0 for d in draws} == {True, False}


def test_inside_a_glowing_ball_the_walls_light_each_other_as_the_integral_says() -> None:
    """Irradiance over pi that a point of a unit-radiance sphere gets from a part of it is that part's share of area."""
    rays = make_camera(CameraConfig(width=64, height=64, fov_deg=90.0)).rays()
    points, normals = 20 * rays, -rays
    got = bounced(points, normals, np.ones_like(points))
    np.testing.assert_allclose(got, 1 / 6, rtol=0.03)  # a square 90-degree view sees one face of the cube


def test_walls_light_each_other_more_the_more_they_reflect_and_not_at_all_when_off() -> None:
    rays = make_camera(CameraConfig(width=32, height=32, fov_deg=90.0)).rays()
    points, normals = 20 * rays, -rays
    albedo, gloss, lit = np.full_like(points, 0.5), np.ones(points.shape[:2], np.float32), np.ones((2, 32, 32))
    plain, once, twice = (
        shade(points, normals, albedo, gloss, lit.astype(np.float32), replace(ImagingConfig(), bounce=bounce))
        for bounce in (0.0, 1.0, 2.0)
    )
    np.testing.assert_allclose(twice - plain, 2 * (once - plain), rtol=1e-4)
    assert (once > plain).all()
