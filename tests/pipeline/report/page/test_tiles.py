"""The tiles at the top of the report."""

import pytest

from pipeline.report.page.summary import cards

JUDGED = {"judged": True, "covered_percent": 70.0, "stretch": 9.0, "missed_regions": [], "listed_from": 5.0}
OPEN = {"judged": False, "reason": "too open"}


def tiles(coverage, scales, keyframes=1):
    main = {"coverage": coverage | {"smaller_regions": 0}, "unit": "mm", "keyframes": keyframes, "faces": 9}
    main |= {"path_length": 3.0, "area": 4.0}
    submaps = [main | {"scale": scale} for scale in scales]
    return cards({"frames": {"posed": 8, "total": 9}, "submaps": submaps}).split('<div class="card">')[1:]


@pytest.mark.parametrize("coverage", [JUDGED, OPEN])
def test_every_tile_of_the_largest_submap_says_so(coverage):
    """Also that of missed regions, of which the others have more, why coverage is not judged, and its own scale."""
    said = ["largest of 2 submaps" in tile for tile in tiles(coverage, ("by the sensor: 31", "by the sensor: 35"))]
    assert len(said) == (6 if coverage is JUDGED else 5)
    assert all(said)
    assert "largest" not in tiles(coverage, ("none given", "none given"))[-1]
    assert "largest" not in "".join(tiles(coverage, ("none given",)))


def test_one_keyframe_is_one():
    assert "1 keyframe completed" in "".join(tiles(OPEN, ("none given",)))
