"""Noise of a sensor must not move the scale: what least squares in the inverse depth make of it, against the truth."""

import cv2
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from haustra.core.errors import HaustraError
from pipeline.config import SensorSettings
from pipeline.input.sensor.sensor_depth import SensorDepth, check_sensor

SIDE, TRUE_MM, UNIT_MM = 300, 40.0, 0.001


def sensor_of(folder, values, **errors):
    """A sensor of one picture with these depths (SIDE*SIDE,), mm, and its pixels."""
    raw = np.rint(values / UNIT_MM).reshape(SIDE, SIDE).astype(np.uint16)
    cv2.imwrite(str(folder / "0.png"), raw)
    settings = SensorSettings(**{"error_mm": 0.0, "error_relative": 0.0, "error_per_mm": 0.0} | errors)
    sensor = SensorDepth({0: folder / "0.png"}, settings, UNIT_MM, (0, 0, SIDE, SIDE), 1.0, (SIDE, SIDE))
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5
    return sensor, np.column_stack([x.ravel(), y.ravel()])


def depth_by_least_squares(depth, sigma):
    """The depth at which the squared residuals of `depth_residuals` sum to least."""
    cost = lambda z: (((depth / z - 1) * depth / sigma) ** 2).sum()  # noqa: E731
    return minimize_scalar(cost, bounds=(0.5 * TRUE_MM, 2 * TRUE_MM), method="bounded", options={"xatol": 1e-8}).x


@pytest.mark.parametrize("share", [0.02, 0.05])
def test_noise_that_is_symmetric_in_depth(tmp_path, share):
    rng = np.random.default_rng(0)
    values = TRUE_MM * (1 + share * rng.normal(size=SIDE**2))
    sensor, pixels = sensor_of(tmp_path, values, error_relative=share)
    within = 4 * share / SIDE  # four standard errors of the mean
    assert depth_by_least_squares(*sensor.for_adjustment(0, pixels)) == pytest.approx(TRUE_MM, rel=within)
    assert depth_by_least_squares(*sensor.measured(0, pixels)) / TRUE_MM - 1 == pytest.approx(share**2, abs=within)


def test_noise_of_a_stereo_pair_is_left_alone(tmp_path):
    rng = np.random.default_rng(1)
    per_mm = 0.03 / TRUE_MM  # 3 % at that depth
    values = 1 / (1 / TRUE_MM + per_mm * rng.normal(size=SIDE**2))
    sensor, pixels = sensor_of(tmp_path, values, error_per_mm=per_mm)
    for told in (sensor.for_adjustment(0, pixels), sensor.measured(0, pixels)):
        assert depth_by_least_squares(*told) == pytest.approx(TRUE_MM, rel=4 * 0.03 / SIDE)
    np.testing.assert_array_equal(sensor.for_adjustment(0, pixels)[0], sensor.measured(0, pixels)[0])


def test_where_there_is_no_depth_there_is_none(tmp_path):
    sensor, pixels = sensor_of(tmp_path, np.zeros(SIDE**2), error_relative=0.02)
    depth, sigma = sensor.for_adjustment(0, pixels)
    assert not depth.any()
    assert not sigma.any()
    assert not sensor.for_adjustment(7, pixels)[0].any()


@pytest.mark.parametrize("unit", ["0", "-1", "NaN", "1e400", "null", '"ten"', "[]", "true", "1" + 400 * "0"])
def test_a_unit_that_is_none_is_one_sentence(tmp_path, unit):
    (tmp_path / "depth").mkdir()
    cv2.imwrite(str(tmp_path / "depth/0.png"), np.full((8, 8), 3000, np.uint16))
    (tmp_path / "camera.json").write_text(f'{{"depth": "sensor", "depth_unit_mm": {unit}}}')
    with pytest.raises(HaustraError, match=r"depth_unit_mm in .*camera.json is .*no length"):
        check_sensor(tmp_path, SensorSettings(), 0)
