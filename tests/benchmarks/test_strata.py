"""Strata of several films are pooled pixel by pixel."""

import pytest

from benchmarks.completion.strata import pooled


def film(pixels: int, within: float, error: float, kept: float, close: float | None) -> dict:
    return {"pixels": pixels, "within_one": within, "abs_rel": error, "kept": kept, "kept_close": close}


def test_every_pixel_counts_the_same_and_closeness_is_of_kept_pixels() -> None:
    found = pooled([film(100, 0.5, 0.1, 0.2, 1.0), film(300, 0.9, 0.3, 0.6, 0.5)])
    assert found["pixels"] == 400
    assert found["within_one"] == pytest.approx(0.8)
    assert found["abs_rel"] == pytest.approx(0.25)
    assert found["kept"] == pytest.approx(0.5)
    assert found["kept_close"] == pytest.approx((20 * 1.0 + 180 * 0.5) / 200)


def test_a_film_that_keeps_nothing_takes_nothing_away() -> None:
    found = pooled([film(100, 0.5, 0.1, 0.0, None), film(100, 0.5, 0.1, 0.5, 0.8)])
    assert found["kept_close"] == pytest.approx(0.8)
    assert pooled([film(10, 0.5, 0.1, 0.0, None)])["kept_close"] is None
