"""Tracking backwards: frames before a map's beginning are posed rightly, and maps that share frames become one."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haustra.core.sim3 import umeyama
from pipeline.frontend.odometry.backward_tracking import extend_backwards
from pipeline.frontend.odometry.klt import tracker_image
from pipeline.frontend.odometry.tracking import KEYFRAME_MOTION
from pipeline.mapping.local_map import LocalMap
from pipeline.mapping.submap_of_map import to_submap
from tests.helpers.tubes.textured_tube import CAMERA, MASK, camera_at, render, run

COUNT = 90
NOTHING = np.full((CAMERA.height, CAMERA.width, 3), 90, np.uint8)


@pytest.fixture(scope="module")
def images() -> list[np.ndarray]:
    return [render(camera_at(k)) for k in range(COUNT)]


def extended(maps: list[LocalMap], images: list[np.ndarray], index: np.ndarray) -> tuple[list[LocalMap], int]:
    def look(frame: int):
        return images[frame], tracker_image(images[frame], MASK)

    return extend_backwards(maps, index, look, 1, KEYFRAME_MOTION, 0)


def errors(local_map: LocalMap) -> tuple[float, float]:
    """Worst distance of the camera centres in mm after a Sim(3), and worst rotation in degrees."""
    submap = to_submap(local_map, CAMERA.params)
    assert submap is not None
    truth = np.stack([camera_at(int(frame)) for frame in submap.frames])
    similarity = umeyama(submap.centres, truth[:, :3, 3], with_scale=True)
    centres = submap.centres @ similarity[:3, :3].T + similarity[:3, 3]
    scale = np.cbrt(np.linalg.det(similarity[:3, :3]))
    turned = np.swapaxes(truth[:, :3, :3], 1, 2) @ (similarity[:3, :3] / scale) @ submap.world_from_camera[:, :3, :3]
    off = np.linalg.norm(centres - truth[:, :3, 3], axis=1).max()
    return float(off), float(np.degrees(Rotation.from_matrix(turned).magnitude()).max())


def test_frames_before_a_map_began_are_posed(images: list[np.ndarray]) -> None:
    begun = 40
    film = [NOTHING] * begun + images[begun:]
    (local_map,), _ = run(film)
    assert min(local_map.frames) >= begun
    _, turned_before = errors(local_map)
    (whole,), stitched = extended([local_map], images, np.arange(COUNT))
    assert stitched == 0
    assert whole.frames >= set(range(5, COUNT))
    off, turned = errors(whole)
    assert off < 0.5  # of a path of 72 mm
    assert turned < 1.5 * turned_before  # a path so nearly straight hardly fixes the alignment's tilt
    for keyframe in whole.keyframes:  # a corner that was tracked to both sides is one track
        assert len(np.unique(keyframe.ids)) == len(keyframe.ids)
        assert len(np.unique(keyframe.pixels, axis=0)) == len(keyframe.pixels)
    both = [frame for frame in whole.keyframes if frame.frame >= begun]
    earlier = [frame for frame in whole.keyframes if frame.frame < begun]
    assert len(np.intersect1d(earlier[-1].ids, both[0].ids)) > 0.3 * len(earlier[-1].ids)


def test_two_maps_parted_by_a_few_blind_frames_become_one(images: list[np.ndarray]) -> None:
    blind = range(44, 47)
    jump = [image for k, image in enumerate(images) if k < 44 or k >= 47]  # the tracker sees a jump here
    film = [NOTHING if k in blind else image for k, image in enumerate(images)]
    index = np.array([k for k in range(COUNT) if k not in blind])
    maps = [run(jump[:44])[0][0]]
    (second,), _ = run([NOTHING] * 47 + images[47:])
    whole, stitched = extended([*maps, second], film, index)
    assert (len(whole), stitched) == (1, 1)
    assert len(whole[0].frames & set(index.tolist())) > 0.95 * len(index)
    off, turned = errors(whole[0])
    assert off < 1.0
    assert turned < 1.5


def test_maps_of_two_places_are_not_joined(images: list[np.ndarray]) -> None:
    elsewhere = [image[:, ::-1].copy() for image in images]  # mirrored: no motion explains both
    (first,), _ = run(images[:45])
    (second,), _ = run([NOTHING] * 45 + elsewhere[45:])
    film = images[:45] + elsewhere[45:]
    whole, stitched = extended([first, second], film, np.arange(COUNT))
    assert (len(whole), stitched) == (2, 0)
    assert whole[0].frames == first.frames
    assert min(whole[1].frames) > 35  # no more of the other film than chance


def test_a_map_from_the_first_frame_on_is_left_as_it_is(images: list[np.ndarray]) -> None:
    (local_map,), _ = run(images[:40])
    assert min(local_map.frames) == 0
    (same,), stitched = extended([local_map], images, np.arange(40))
    assert same is local_map
    assert stitched == 0


def test_two_runs_agree(images: list[np.ndarray]) -> None:
    film = [NOTHING] * 40 + images[40:70]
    poses = []
    for _ in range(2):
        (whole,), _ = extended(run(film)[0], images, np.arange(70))
        poses.append(np.stack([keyframe.camera_from_world for keyframe in whole.keyframes]))
    np.testing.assert_array_equal(*poses)
