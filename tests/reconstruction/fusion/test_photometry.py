"""Shading correction of walls of known reflectance under known illumination."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from reconstruction.fusion.lamp import Lamp
from reconstruction.fusion.photometry import GAMMA, _blurred, fit_illumination, geometry

K = np.array([[80.0, 0, 64], [0, 80, 48], [0, 0, 1]])
HEIGHT, WIDTH = 96, 128


def tube(radius, tilt_x, tilt_y):
    """z-depth (H,W) of a tube seen from inside, off its axis and looking at its wall; distance and slant, exact.

    Not a plane: there the logarithms of distance and slant differ by a constant, and no fit could part them.
    """
    x = (np.arange(WIDTH) + 0.5 - K[0, 2]) / K[0, 0]
    y = (np.arange(HEIGHT) + 0.5 - K[1, 2]) / K[1, 1]
    ray = np.stack([*np.meshgrid(x, y), np.ones((HEIGHT, WIDTH))], axis=-1)
    axis = np.array([1 + tilt_x, tilt_y, 0.6])
    axis /= np.linalg.norm(axis)
    start = radius * np.array([0.1, 0.4, -0.2])
    across, origin = ray - (ray @ axis)[..., None] * axis, start - (start @ axis) * axis
    a, b, c = (across**2).sum(-1), across @ origin, origin @ origin - radius**2
    depth = (-b + np.sqrt(b**2 - a * c)) / a
    inward = -(origin + depth[..., None] * across) / radius
    length = np.linalg.norm(ray, axis=-1)
    return depth.astype(np.float32), depth * length, -(ray * inward).sum(-1) / length


def lit(radius, tilt_x, tilt_y, exposure_gain, exponents, seed=0, spot=1.0):
    """Image and depth of a blotchy tube lit from the camera, and its reflectance; spot (H,W): of a lamp of its own."""
    depth, distance, cosine = tube(radius, tilt_x, tilt_y)
    rng = np.random.default_rng(seed)
    blotches = 1 + 0.15 * np.kron(rng.normal(0, 1, (HEIGHT // 8, WIDTH // 8)), np.ones((8, 8)))
    reflectance = np.clip(blotches, 0.6, 1.4)[..., None] * np.array([0.6, 0.3, 0.2])
    ahead = depth / distance
    light = exposure_gain * (distance / 20) ** exponents[0] * cosine ** exponents[1] * ahead ** exponents[2] * spot
    rgb = np.rint(255 * np.clip(reflectance * light[..., None], 0, 1) ** (1 / GAMMA)).astype(np.uint8)
    return rgb, depth, reflectance


TUBES = [(20, 0.5, 0.1, 0.9), (14, -0.3, 0.4, 0.5), (30, 0.2, -0.6, 1.8), (18, -0.6, -0.2, 0.7), (24, 0, 0.5, 1.0)]


@pytest.mark.parametrize("exponents", [(-2.0, 1.0, 0.0), (-1.2, 0.5, 1.5)])
def test_exponents_are_found_whatever_each_frames_exposure_gain(exponents):
    frames = [lit(*shape, exponents, seed)[:2] for seed, shape in enumerate(TUBES)]
    illumination = fit_illumination(frames, K)
    assert illumination.frames == len(TUBES)
    assert illumination.distance == pytest.approx(exponents[0], abs=0.1)
    assert illumination.slant == pytest.approx(exponents[1], abs=0.15)
    assert illumination.axis == pytest.approx(exponents[2], abs=0.15)


def test_what_is_left_is_the_reflectance_up_to_one_factor_for_the_film():
    shown = [lit(*shape, (-2.0, 1.0, 0.0), seed) for seed, shape in enumerate(TUBES)]
    illumination = fit_illumination([(rgb, depth) for rgb, depth, _ in shown], K)
    ratios, before = [], []
    for (rgb, depth, reflectance), shape in zip(shown, TUBES, strict=True):
        _, distance, cosine = tube(*shape[:3])
        fair = (distance < 50) & (
            cosine > 0.3
        )  # farther and flatter, the correction's bound or the grey levels' steps rule
        result = illumination.shading_corrected(rgb, depth, K)
        fair &= result.max(axis=-1) < 250
        ratios.append(np.log((result[fair] / 255) ** GAMMA / reflectance[fair]))
        before.append(np.log((rgb[fair] / 255) ** GAMMA / reflectance[fair]))
    spread = np.std(np.concatenate(ratios))
    assert spread < 0.08  # a mean blotch differs from frame to frame by a few percent
    assert np.std(np.concatenate(before)) > 5 * spread


def test_a_film_without_depth_has_no_illumination_and_a_frame_without_depth_stays_as_it_is():
    rgb, depth, _ = lit(*TUBES[0], (-2.0, 1.0, 0.0))
    assert fit_illumination([(rgb, np.zeros_like(depth))], K) is None
    illumination = fit_illumination([(rgb, depth)], K)
    np.testing.assert_array_equal(illumination.shading_corrected(rgb, np.zeros_like(depth), K), rgb)
    holed = depth.copy()
    holed[:, :64] = np.nan
    np.testing.assert_array_equal(illumination.shading_corrected(rgb, holed, K)[:, :60], rgb[:, :60])


def test_glints_do_not_bend_the_fit():
    frames = []
    for seed, shape in enumerate(TUBES):
        rgb, depth, _ = lit(*shape, (-2.0, 1.0, 0.0), seed)
        rgb[30:40, 40:60] = 255
        frames.append((rgb, depth))
    illumination = fit_illumination(frames, K)
    assert illumination.distance == pytest.approx(-2, abs=0.1)


@settings(max_examples=25, deadline=None)
@given(scale=st.floats(0.01, 100), seed=st.integers(0, 9))
def test_the_unit_of_depth_does_not_matter(scale, seed):
    frames = [lit(*shape, (-2.0, 1.0, 0.0), k)[:2] for k, shape in enumerate(TUBES[:2])]
    illumination = fit_illumination(frames, K, seed)
    scaled = fit_illumination([(rgb, depth * np.float32(scale)) for rgb, depth in frames], K, seed)
    rgb, depth = frames[0]
    there = illumination.shading_corrected(rgb, depth, K).astype(int)
    assert np.abs(scaled.shading_corrected(rgb, depth * np.float32(scale), K).astype(int) - there).max() <= 1


def test_geometry_of_a_tube_is_exact():
    depth, distance, cosine = tube(20, 0.5, 0.1)
    got = geometry(depth, K, 0)
    np.testing.assert_allclose(got[0], distance, rtol=1e-5)
    np.testing.assert_allclose(got[1][2:-2, 2:-2], cosine[2:-2, 2:-2], atol=5e-3)


def test_rough_depth_hardly_changes_the_picture():
    """Completed depth is a few percent rough; its raw normals would paint that roughness onto the wall."""
    rng = np.random.default_rng(0)
    rgb, depth, _ = lit(*TUBES[0], (-2.0, 1.0, 0.0))
    illumination = fit_illumination([(rgb, depth)], K)
    rough = (depth * (1 + 0.02 * rng.normal(size=depth.shape))).astype(np.float32)
    change = illumination.shading_corrected(rgb, rough, K).astype(int) - illumination.shading_corrected(rgb, depth, K)
    assert np.median(np.abs(change)) <= 4


def test_each_frame_is_brought_to_the_films_median():
    """The exposure gain is unknown: half the reflectance looks like half the exposure gain."""
    shape = TUBES[0]
    illumination = fit_illumination([lit(*shape, (-2.0, 1.0, 0.0))[:2]], K)
    darker = (*shape[:3], shape[3] / 2)
    one, other = (illumination.shading_corrected(*lit(*s, (-2.0, 1.0, 0.0))[:2], K) for s in (shape, darker))
    assert np.median(np.abs(one.astype(int) - other)) <= 2


def test_two_fits_agree():
    frames = [lit(*shape, (-2.0, 1.0, 0.0), k)[:2] for k, shape in enumerate(TUBES)]
    assert fit_illumination(frames, K, 3) == fit_illumination(frames, K, 3)


@pytest.mark.parametrize("unit", [1.0, 1000.0])
def test_depth_is_blurred_as_scipy_would(unit):
    """The logarithm, over the known pixels alone, reflected at the border; whatever the unit."""
    rng = np.random.default_rng(7)
    depth = (unit * tube(20.0, 0.2, 0.1)[0] * np.exp(rng.normal(0, 0.05, (HEIGHT, WIDTH)))).astype(np.float32)
    depth[rng.random(depth.shape) < 0.2] = 0
    known = depth > 0
    log = np.where(known, np.log(np.maximum(depth, 1e-9).astype(np.float64)), 0)
    mean = gaussian_filter(log, 2.5) / gaussian_filter(known.astype(np.float64), 2.5)
    blurred = _blurred(depth, 2.5)
    np.testing.assert_allclose(blurred[known], np.exp(mean)[known], rtol=2e-6)
    assert (blurred[~known] == 0).all()


def test_a_lamp_that_was_measured_explains_what_no_exponent_of_the_cosine_can():
    """A spot light that points 20 degrees to the right: e^(-3 (1 - D . ray)), as EndoMapper's calibration has it."""
    axis = np.array([np.sin(np.radians(20)), 0, np.cos(np.radians(20))])
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    rays = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(x)], axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    spot = np.exp(-3 * (1 - rays @ axis))
    shown = [lit(*shape, (-2.0, 1.0, 0.0), seed, spot) for seed, shape in enumerate(TUBES)]
    frames, truths = [(rgb, depth) for rgb, depth, _ in shown], [reflectance[..., 1] for *_, reflectance in shown]

    def spread(fitted):
        shown = [(fitted.shading_corrected(rgb, depth, K)[..., 1] / 255) ** GAMMA for rgb, depth in frames]
        usable = [rgb.max(axis=2) > 30 for rgb, _ in frames]
        parts = zip(shown, truths, usable, strict=True)
        off = np.concatenate([np.log(np.maximum(image, 1e-3) / true)[good] for image, true, good in parts])
        return np.median(np.abs(off - np.median(off)))

    measured = fit_illumination(frames, K, lamp=Lamp(tuple(axis), 3.0))
    assert measured.distance == pytest.approx(-2, abs=0.1)
    assert measured.slant == pytest.approx(1, abs=0.15)
    assert measured.axis == 1
    assert spread(measured) < 0.5 * spread(fit_illumination(frames, K))
