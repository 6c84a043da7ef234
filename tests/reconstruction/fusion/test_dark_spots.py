"""A dark mouth with a lit lip is a spot; vessels, patches, shades, uneven walls and the mesh's end are none."""

import numpy as np
import pytest

from reconstruction.fusion.dark_spots import MOST_DARK, dark_spots, without_vertices
from reconstruction.mesh.surface_mesh import SurfaceMesh

SIDE = 200  # vertices of the wall along each side, a voxel apart
GAMMA = 2.2


def wall(luminance: np.ndarray, voxel: float = 1.0) -> SurfaceMesh:
    """A plane of SIDE x SIDE vertices, each of that luminance (SIDE,SIDE)."""
    rows, columns = np.mgrid[:SIDE, :SIDE]
    number = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    a, b, c, d = (n.ravel() for n in (number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])
    grey = np.rint(255 * luminance.clip(0, 1) ** (1 / GAMMA)).astype(np.uint8).ravel()
    vertices = voxel * np.stack([columns, rows, np.zeros_like(rows)], axis=-1).reshape(-1, 3)
    return SurfaceMesh.from_triangles(vertices, faces, np.repeat(grey[:, None], 3, axis=1))


def away() -> np.ndarray:
    """Distance of each vertex from the middle of the wall, in voxels."""
    rows, columns = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
    return np.hypot(rows, columns)


def lit() -> np.ndarray:
    """A wall of some texture."""
    return 0.4 * np.exp(np.random.default_rng(0).normal(0, 0.1, (SIDE, SIDE)))


def mouth(radius: float, distance: np.ndarray) -> np.ndarray:
    """A dark mouth whose rounded edge faces the lamp."""
    return np.select([distance < radius, distance < radius + 10], [0.3, 1.15], 1.0)


@pytest.mark.parametrize("voxel", [1.0, 0.013])
def test_a_dark_mouth_is_found_and_leaves_a_hole_of_its_size(voxel: float) -> None:
    mesh = wall(mouth(10, away()) * lit(), voxel)
    spots = dark_spots(mesh, voxel)
    found = away().ravel()[spots]
    assert found.max() < 12
    assert len(found) > 0.7 * np.pi * 10**2
    opened = without_vertices(mesh, spots)
    middle = voxel * (SIDE - 1) / 2
    assert np.linalg.norm(opened.vertices[:, :2] - middle, axis=1).min() > 6 * voxel
    assert opened.face_areas.sum() < mesh.face_areas.sum()


def test_two_mouths_are_two_holes() -> None:
    rows, columns = np.mgrid[:SIDE, :SIDE]
    first, second = np.hypot(rows - 40, columns - 40), np.hypot(rows - 85, columns - 85)
    spots = dark_spots(wall(mouth(8, first) * mouth(8, second) * lit()), 1.0).reshape(SIDE, SIDE)
    assert spots[40, 40]
    assert spots[85, 85]
    assert not spots[60:65, 60:65].any()


def test_the_hole_reaches_as_far_as_the_wall_stays_darker_than_usual() -> None:
    """A mouth that is lit on one side has a middle that is half as wide as it is."""
    rows, columns = np.mgrid[:SIDE, :SIDE] - SIDE // 2
    lit_half = np.where((away() < 10) & (columns > 0), 0.65, mouth(10, away()))
    spots = dark_spots(wall(lit_half * lit()), 1.0).reshape(SIDE, SIDE)
    assert spots[(np.hypot(rows, columns - 5) < 2)].all()
    faint = np.where(away() < 10, 0.65, mouth(10, away()))
    assert not dark_spots(wall(faint * lit()), 1.0).any()


@pytest.mark.parametrize("radius", [12, 15])
def test_a_dark_speck_does_not_open_the_faint_patch_around_it(radius: float) -> None:
    patch = np.select([away() < 4, away() < radius, away() < radius + 10], [0.5, 0.68, 1.15], 1.0)
    assert not dark_spots(wall(patch * lit()), 1.0).any()
    with pytest.MonkeyPatch.context() as change:
        change.setattr("reconstruction.fusion.dark_spots.MIDDLE_SHARE", 0.0)
        assert dark_spots(wall(patch * lit()), 1.0).any()


def test_faint_shades_elsewhere_do_not_keep_a_mouth_closed() -> None:
    rows, columns = np.mgrid[:SIDE, :SIDE]
    shades = np.where(np.hypot(rows % 50 - 25, columns % 50 - 25) < 10, 0.66, 1.0) * np.ones((SIDE, SIDE))
    shades[75:125, 75:125] = 1.0
    assert (shades < 0.7).mean() > MOST_DARK
    assert dark_spots(wall(shades * mouth(9, away()) * lit()), 1.0).any()


def test_what_fades_into_the_wall_around_is_no_hole() -> None:
    shade = np.exp(-1.2 * np.exp(-((away() / 14) ** 2)))
    assert not dark_spots(wall(shade * lit()), 1.0).any()


@pytest.mark.parametrize("seed", range(6))
def test_a_dark_patch_without_a_bright_rim_is_tissue(seed: int) -> None:
    texture = 0.4 * np.exp(np.random.default_rng(seed).normal(0, 0.1, (SIDE, SIDE)))
    assert not dark_spots(wall(np.where(away() < 9, 0.3, 1) * texture), 1.0).any()


def test_a_vessel_is_thinner_than_a_mouth() -> None:
    rows, columns = np.abs(np.mgrid[:SIDE, :SIDE] - SIDE // 2)
    vessel = np.where(rows < 30, mouth(1.5, columns), 1.0)
    assert 60 <= (vessel < 0.5).sum() <= 200
    assert not dark_spots(wall(vessel * lit()), 1.0).any()


def test_what_is_larger_or_smaller_than_mouths_is_none() -> None:
    broad, speck = mouth(18, away()), mouth(1.8, away())
    speck[speck < 0.5] = 0.05
    assert (broad < 0.5).mean() < MOST_DARK
    for luminance, limit, changed in ((broad, "SPOT_VERTICES", 2000), (speck, "MIDDLE_VERTICES", 1)):
        mesh = wall(luminance * lit())
        assert not dark_spots(mesh, 1.0).any()
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(f"reconstruction.fusion.dark_spots.{limit}", changed)
            assert dark_spots(mesh, 1.0).any()  # for its size alone it was none


def test_where_much_of_the_wall_is_dark_darkness_says_nothing() -> None:
    rows, columns = np.mgrid[:SIDE, :SIDE]
    mesh = wall(mouth(8, np.hypot(rows % 50 - 25, columns % 50 - 25)) * lit())
    assert not dark_spots(mesh, 1.0).any()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("reconstruction.fusion.dark_spots.MOST_DARK", 1.0)
        assert dark_spots(mesh, 1.0).any()


def test_a_mouth_that_the_mesh_ends_in_is_none_but_one_with_a_hole_already_is() -> None:
    rows, columns = np.mgrid[:SIDE, :SIDE]
    at_end = np.hypot(rows - 3, columns - SIDE / 2)
    assert not dark_spots(wall(mouth(10, at_end) * lit()), 1.0).any()
    pierced = without_vertices(wall(mouth(10, away()) * lit()), (away() < 4).ravel())
    assert dark_spots(pierced, 1.0).sum() > 100


def test_a_mesh_without_dark_wall_or_without_any_wall_has_none() -> None:
    assert not dark_spots(wall(np.full((SIDE, SIDE), 0.0)), 1.0).any()
    assert dark_spots(SurfaceMesh.from_triangles([], []), 1.0).shape == (0,)
