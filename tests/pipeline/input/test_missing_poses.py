"""What programs write where they have no pose, and poses that mirror."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haustra.core.errors import HaustraError
from pipeline.input.pose_files.registry import read_poses

TURNS = Rotation.from_rotvec(np.random.default_rng(0).normal(size=(5, 3)))
NDI_MISSING = "-3.697314E28"


def tum(place):
    return "\n".join(f"{k / 30} {place if k == 2 else k} 0 0 0 0 0 1" for k in range(5))


def colmap(place):
    return "\n".join(f"{k + 1} 1 0 0 0 {place if k == 2 else k} 0 0 1 {k:03d}.png\n" for k in range(5))


@pytest.mark.parametrize(("name", "write"), [("a.tum", tum), ("images.txt", colmap)])
@pytest.mark.parametrize(("place", "sentence"), [("nan", "finite"), ("inf", "finite"), (NDI_MISSING, "3.7e\\+28 from")])
def test_a_place_where_no_camera_is(tmp_path, name, write, place, sentence):
    (tmp_path / name).write_text(write(1))
    assert len(read_poses(tmp_path / name).world_from_camera) == 5
    (tmp_path / name).write_text(write(place))
    with pytest.raises(HaustraError, match=sentence):
        read_poses(tmp_path / name)


def test_ndis_number_for_a_missing_place_is_a_line_without_a_pose(tmp_path):
    np.savetxt(tmp_path / "eye.txt", np.eye(4))
    lines = [f"{NDI_MISSING},{NDI_MISSING},0,1,0,0,0" if k == 2 else f"{k},0,0,1,0,0,0" for k in range(5)]
    (tmp_path / "a.csv").write_text("\n".join(["Tx,Ty,Tz,Q0,Qx,Qy,Qz", *lines]))
    table = read_poses(tmp_path / "a.csv", tmp_path / "eye.txt")
    assert table.lines == (0, 1, 3, 4)
    np.testing.assert_array_equal(table.world_from_camera[:, 0, 3], [0, 1, 3, 4])


def test_poses_that_mirror_are_said_to(tmp_path):
    turns = TURNS.as_matrix() * np.array([1, 1, -1])
    np.savetxt(tmp_path / "00.txt", np.concatenate([turns, np.zeros((5, 3, 1))], axis=2).reshape(5, 12))
    with pytest.raises(HaustraError, match=r"mirrors .* left-handed"):
        read_poses(tmp_path / "00.txt")
