"""Features of keyframes: found once, by whoever asks first, and the same as asked for directly."""

import gc
import threading
import weakref
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from haustra.core.camera import Camera
from haustra.core.errors import HaustraError
from haustra.core.ray_table import RayTable
from pipeline.matching.keyframe_features import features_of_view
from pipeline.matching.sift import detect_sift
from pipeline.matching.sift_cache import SiftCache
from tests.helpers.tubes.textured_tube import CAMERA, MASK, camera_at, render, run

IMAGE = render(camera_at(0))


def test_each_frame_is_read_once_and_gives_what_sift_gives():
    asked = []

    def read(frame):
        asked.append(frame)
        return np.roll(IMAGE, frame, axis=1), MASK

    with SiftCache(read) as find:
        find.begin(3)
        find.begin(3)
        found = [find(frame) for frame in (3, 5, 3)]
    assert sorted(asked) == [3, 5]
    expected = detect_sift(np.roll(IMAGE, 3, axis=1), MASK)
    assert found[0] is found[2]
    for name in ("pixels", "descriptors", "sizes"):
        np.testing.assert_array_equal(getattr(found[0], name), getattr(expected, name))


def test_what_was_found_is_forgotten_at_the_end():
    with SiftCache(lambda frame: (IMAGE, MASK)) as find:
        kept = weakref.ref(find(0))
        assert kept() is not None
    gc.collect()
    assert kept() is None


def same(first, second):
    return all(
        np.array_equal(getattr(first, name), getattr(second, name)) for name in ("pixels", "descriptors", "sizes")
    )


def test_of_a_long_film_the_latest_stay_in_memory_and_the_others_in_files(tmp_path):
    asked, folder = [], tmp_path / "features"

    def read(frame):
        asked.append(frame)
        return np.roll(IMAGE, frame, axis=1), MASK

    with SiftCache(read, folder, held=2) as find:
        find.begin(0)
        references = [weakref.ref(find(frame)) for frame in range(6)]
        gc.collect()
        assert sum(reference() is not None for reference in references) <= 3  # one more may be under way
        assert len(list(folder.iterdir())) >= 3
        for frame in (0, 5, 1):
            find.begin(frame)
            assert same(find(frame), detect_sift(*read(frame)))
        assert asked == [0, 1, 2, 3, 4, 5, 0, 5, 1], "only the test read again"
    assert not folder.exists()


def test_files_that_were_tidied_away_and_a_disk_that_is_full_cost_nothing_but_time(tmp_path):
    folder, asked = tmp_path / "features", []

    def read(frame):
        asked.append(frame)
        return IMAGE, MASK

    with SiftCache(read, folder, held=1) as find:
        first = find(0)
        for frame in (1, 2, 3):
            find(frame)
        for path in folder.iterdir():
            path.write_bytes(b"cut")
        assert same(find(0), first)
    assert asked == [0, 1, 2, 3, 0]
    (tmp_path / "file").write_text("no folder can be made here")
    with SiftCache(read, tmp_path / "file" / "features", held=1) as find:
        for frame in (0, 1, 2, 0, 1, 2):
            assert same(find(frame), first)
    assert asked == [0, 1, 2, 3, 0, 0, 1, 2]


def test_what_has_not_begun_is_found_by_whoever_asks():
    """One thread is busy with the first frame; the third is asked for, and does not wait for it."""
    go, by = threading.Event(), {}

    def read(frame):
        by[frame] = threading.current_thread()
        if frame == 0:
            go.wait(10)
        return IMAGE, MASK

    with SiftCache(read) as find:
        for frame in range(3):
            find.begin(frame)
        find(2)
        assert 1 not in by
        go.set()
        find(0), find(1)
    assert by[2] is threading.current_thread()
    assert by[0] is not threading.current_thread()


def test_many_who_ask_at_once_read_each_frame_once():
    asked = []

    def read(frame):
        asked.append(frame)
        return IMAGE, MASK

    with SiftCache(read) as find, ThreadPoolExecutor(6) as threads:
        for frame in range(6):
            find.begin(frame)
        found = list(threads.map(find, [frame for frame in range(6) for _ in range(4)]))
    assert sorted(asked) == list(range(6))
    assert all(found[k] is found[k - k % 4] for k in range(24))


def test_what_reading_raises_is_raised_by_the_call():
    def read(frame):
        raise HaustraError(f"{frame} is missing")

    with SiftCache(read) as find:
        find.begin(7)
        for frame in (7, 8, 8):  # begun before, and not
            with pytest.raises(HaustraError, match=f"{frame} is missing"):
                find(frame)


def test_leaving_does_not_wait_for_what_nobody_asked_for():
    """Ctrl-C in the midst of tracking: what has not begun is dropped."""
    go, begun = threading.Event(), []

    def read(frame):
        begun.append(frame)
        go.wait(10)
        return IMAGE, MASK

    with SiftCache(read) as find:
        for frame in range(50):
            find.begin(frame)
        threading.Timer(0.2, go.set).start()
    assert len(begun) <= 4


def test_features_lie_where_the_lens_has_rays():
    """What a lens cannot see along is no part of a place, though the picture shows something there."""
    (local_map,), _ = run([render(camera_at(k)) for k in range(12)])
    with SiftCache(lambda _: (IMAGE, MASK)) as find:
        whole = features_of_view(0, local_map.sparse_view(local_map.keyframes[0]), local_map.rays, find)
        narrow = RayTable(Camera("PINHOLE", CAMERA.width, CAMERA.height, CAMERA.params))
        narrow.usable[:, :90] = 0
        local_map.recalibrate(narrow)
        cut = features_of_view(0, local_map.sparse_view(local_map.keyframes[0]), local_map.rays, find)
    right = whole.pixels[:, 0] >= 90
    assert 0 < right.sum() < len(right)
    np.testing.assert_array_equal(cut.pixels, whole.pixels[right])
