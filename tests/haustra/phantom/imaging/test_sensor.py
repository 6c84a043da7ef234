"""What the phantom's sensor does to light that is known: gain, vignette, encoding, noise, blur."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from haustra.phantom.config import ImagingConfig
from haustra.phantom.imaging.sensor import Sensor, saturated

PLAIN = ImagingConfig(
    exposure=0.2, exposure_smoothing=0.0, gamma=1.0, vignette=0.0, noise=0.0, blur_px=0.0, lights=1, specular=0.0
)


def uniform(value: float, height: int = 40, width: int = 60) -> np.ndarray:
    return np.full((height, width, 3), value, np.float32)


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.mark.parametrize("smoothing", [0.0, 0.5, 0.8, 0.95])
def test_gain_answers_a_step_of_light_as_a_geometric_mean_of_old_and_new(smoothing: float) -> None:
    """k frames after the light doubled, the picture is too bright by 2^(smoothing^k)."""
    sensor = Sensor(replace(PLAIN, exposure_smoothing=smoothing), 60, 40)
    for _ in range(3):
        assert sensor.expose(uniform(3.0), rng()).mean() == pytest.approx(0.2 * 255, abs=0.51)
    for k in range(1, 13):
        shown = sensor.expose(uniform(6.0), rng()).mean() / 255
        assert shown == pytest.approx(0.2 * 2 ** (smoothing**k), abs=0.51 / 255), k


@pytest.mark.parametrize("exposure", [0.1, 0.17, 0.4])
@pytest.mark.parametrize("level", [1e-3, 1.0, 40.0])
def test_gain_settles_where_the_clipped_picture_has_the_wanted_mean(exposure: float, level: float) -> None:
    light = np.exp(np.random.default_rng(1).normal(0, 0.9, (80, 80, 1))).astype(np.float32) * np.ones(3, np.float32)
    sensor = Sensor(replace(PLAIN, exposure=exposure, exposure_smoothing=0.6), 80, 80)
    for _ in range(40):
        shown = sensor.expose(level * light, rng())
    assert shown.max() == 255  # so it is the clipped mean that is meant
    assert shown.mean() / 255 == pytest.approx(exposure, rel=0.05)


def test_gain_is_metered_inside_the_window_only() -> None:
    sensor = Sensor(replace(PLAIN, border="circle"), 60, 60)
    y, x = np.mgrid[:60, :60] - 29.5
    inside = np.hypot(x, y) < 30
    light = np.where(inside, 1.0, 50.0)[..., None].astype(np.float32) * np.ones(3, np.float32)
    shown = sensor.expose(light, rng())
    np.testing.assert_allclose(shown[np.hypot(x, y) < 29.4], 0.2 * 255, atol=0.51)
    np.testing.assert_array_equal(shown[np.hypot(x, y) > 30.6], 0)


@pytest.mark.parametrize("strength", [0.12, 0.5])
def test_vignette_takes_the_stated_part_from_the_corners_and_less_towards_the_middle(strength: float) -> None:
    height, width = 120, 200
    image = Sensor(replace(PLAIN, vignette=strength, exposure=0.6), width, height).expose(
        uniform(1.0, height, width), rng()
    )
    shown = image[..., 1].astype(float)
    middle, side, top, corner = shown[60, 100], shown[60, 0], shown[0, 100], shown[0, 0]
    assert corner / middle == pytest.approx(1 - strength, abs=0.012)
    assert side / middle == pytest.approx(1 - strength / 2, abs=0.012)
    assert top / middle == pytest.approx(1 - strength / 2, abs=0.012)
    assert shown[60, 50] / middle == pytest.approx(1 - strength / 8, abs=0.012)  # the square of half the way
    np.testing.assert_array_equal(shown, shown[::-1, ::-1])


@pytest.mark.parametrize("gamma", [1.0, 1.8, 2.2])
def test_encoding_is_the_gamma_root(gamma: float) -> None:
    levels = np.array([0.02, 0.05, 0.1, 0.2, 0.4, 0.8], np.float32)
    light = np.repeat(levels, 20)[None, :, None] * np.ones((40, 1, 3), np.float32)
    shown = Sensor(replace(PLAIN, gamma=gamma, exposure=float(levels.mean())), 120, 40).expose(light, rng())
    np.testing.assert_allclose(shown[20, 10::20, 0], 255 * levels ** (1 / gamma), atol=0.9)


@pytest.mark.parametrize("noise", [0.004, 0.01, 0.03])
@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_noise_has_the_stated_deviation_of_full_scale_in_the_encoded_picture(noise: float, gamma: float) -> None:
    sensor = Sensor(replace(PLAIN, noise=noise, gamma=gamma), 256, 256)
    field = sensor.expose(uniform(1.0, 256, 256), rng()).astype(float)
    apart = field - field.mean(axis=(0, 1))
    assert field.mean() == pytest.approx(255 * 0.2 ** (1 / gamma), abs=0.1)
    wanted = np.hypot(255 * noise, 1 / np.sqrt(12))  # with that of rounding
    np.testing.assert_allclose(apart.std(axis=(0, 1)), wanted, rtol=0.03)
    channels = np.corrcoef(apart.reshape(-1, 3).T)
    neighbours = np.corrcoef(apart[:, 1:, 0].ravel(), apart[:, :-1, 0].ravel())
    assert np.abs([channels[0, 1], channels[0, 2], channels[1, 2], neighbours[0, 1]]).max() < 0.02


@pytest.mark.parametrize("blur", [0.8, 2.0])
def test_the_lens_blurs_a_line_to_a_bell_of_the_stated_width(blur: float) -> None:
    light = uniform(1e-4, 40, 61)
    light[:, 30] = 1.0
    shown = Sensor(replace(PLAIN, blur_px=blur, exposure=0.01), 61, 40).expose(light, rng())[20, :, 0].astype(float)
    place = np.arange(61) - 30.0
    assert (shown * place).sum() / shown.sum() == pytest.approx(0, abs=0.02)
    assert np.sqrt((shown * place**2).sum() / shown.sum()) == pytest.approx(blur, rel=0.08)


@pytest.mark.parametrize("crosstalk", [0.2, 0.6, 0.9])
def test_overlapping_filters_change_nothing_that_does_not_clip_and_turn_what_is_far_too_bright_white(
    crosstalk: float,
) -> None:
    red = np.array([[[0.7, 0.2, 0.1]]], np.float32)
    np.testing.assert_allclose(saturated(red.copy(), crosstalk), red, atol=1e-6)
    np.testing.assert_allclose(saturated(40 * red, crosstalk), 1.0, atol=1e-6)


def test_channels_that_clip_each_for_itself_stay_red_where_overlapping_ones_are_paler() -> None:
    bright = np.array([[[3.0, 0.9, 0.5]]], np.float32)
    alone, overlapping = (saturated(bright.copy(), crosstalk)[0, 0] for crosstalk in (0.0, 0.6))
    np.testing.assert_allclose(alone, [1.0, 0.9, 0.5], atol=1e-6)
    assert (overlapping >= alone - 1e-6).all()
    assert overlapping[2] > 0.9


def test_a_fixed_gain_ignores_the_picture() -> None:
    sensor = Sensor(replace(PLAIN, fixed_gain=2.0), 60, 40)
    for level in (0.1, 0.3, 0.05):
        assert sensor.expose(uniform(level), rng()).mean() == pytest.approx(2 * level * 255, abs=0.51)


def test_the_error_of_the_first_gain_wears_off_as_any_lag_does() -> None:
    sensor = Sensor(replace(PLAIN, gain_error=3.0, exposure_smoothing=0.8), 60, 40)
    for k in range(12):
        shown = sensor.expose(uniform(5.0), rng()).mean() / 255
        assert shown == pytest.approx(0.2 * 3 ** (0.8**k), abs=0.51 / 255), k
