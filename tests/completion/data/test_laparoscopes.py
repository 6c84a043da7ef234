"""SCARED and Hamlyn in their documented encoding."""

import cv2
import numpy as np
import pytest

from completion.data.readers import read_evaluation_frames, recognise
from haustra.core.errors import CompletionError
from tests.helpers.videos import tiff_of_floats

RGB = np.full((6, 8, 3), 90, np.uint8)


def points(missing):
    """(6,8,3) x y z: z tells row and column, x and y are no depth."""
    z = 40 + np.arange(48).reshape(6, 8)
    found = np.stack([np.full_like(z, -5), np.full_like(z, 3), z], axis=-1).astype(np.float32)
    found[0, 0] = missing
    return found


def test_scared_s_keyframes(tmp_path):
    for number in (1, 2):
        keyframe = tmp_path / f"dataset_1/keyframe_{number}"
        keyframe.mkdir(parents=True)
        cv2.imwrite(str(keyframe / "Left_Image.png"), RGB)
        (keyframe / "left_depth_map.tiff").write_bytes(tiff_of_floats(points(np.nan)))
        storage = cv2.FileStorage(str(keyframe / "endoscope_calibration.yaml"), cv2.FILE_STORAGE_WRITE)
        storage.write("M1", np.array([[1035.3, 0, 596.9], [0, 1035.1, 520.4], [0, 0, 1]]))
        storage.release()
    assert recognise(tmp_path / "dataset_1") == "scared"
    frames = list(read_evaluation_frames(tmp_path / "dataset_1"))
    assert [frame.name for frame in frames] == ["keyframe_1", "keyframe_2"]
    assert (frames[0].unit, frames[0].depth[0, 0], frames[0].depth[2, 3]) == ("mm", 0, 59)
    np.testing.assert_allclose(frames[0].intrinsics, [1035.3, 1035.1, 597.4, 520.9])


def test_scared_as_af_sfmlearner_lays_it_out(tmp_path):
    """Pictures are counted from 1, points from 0; the right eye's points lie below."""
    data = tmp_path / "image_02/data"
    (data / "groundtruth").mkdir(parents=True)
    cv2.imwrite(str(data / "0000000001.png"), RGB)
    both = np.concatenate([points(0), np.full((6, 8, 3), 9, np.float32)])
    (data / "groundtruth/scene_points000000.tiff").write_bytes(tiff_of_floats(both))
    (frame,) = read_evaluation_frames(tmp_path)
    assert frame.depth.shape == (6, 8)
    assert (frame.depth[0, 0], frame.depth[5, 7]) == (0, 87)
    cv2.imwrite(str(data / "groundtruth/scene_points000000.tiff"), RGB)
    with pytest.raises(CompletionError, match="no image of points"):
        list(read_evaluation_frames(tmp_path))


@pytest.mark.parametrize(
    ("kind", "pictures", "depths"), [("hamlyn", "image01", "depth01"), ("hamlyn_tracking", "color", "depth")]
)
def test_hamlyn_ends_at_300_mm(tmp_path, kind, pictures, depths):
    for name in (pictures, depths):
        (tmp_path / name).mkdir()
    cv2.imwrite(str(tmp_path / pictures / "0000000007.jpg"), RGB)
    raw = np.full((6, 8), 62, np.uint16)
    raw[0, :2] = 0, 300
    cv2.imwrite(str(tmp_path / depths / "0000000007.png"), raw)
    (tmp_path / "intrinsics.txt").write_text("383.19 0 155.97 0\n0 383.2 124.33 0\n0 0 1 0\n")
    assert recognise(tmp_path) == kind
    (frame,) = read_evaluation_frames(tmp_path)
    assert (frame.name, frame.depth[0, 0], frame.depth[0, 1], frame.depth[3, 3]) == ("0000000007", 0, 0, 62)
    np.testing.assert_allclose(frame.intrinsics, [383.19, 383.2, 156.47, 124.83])
    (tmp_path / "intrinsics.txt").write_text("one two\n")
    with pytest.raises(CompletionError, match="camera matrix of three rows"):
        list(read_evaluation_frames(tmp_path))
