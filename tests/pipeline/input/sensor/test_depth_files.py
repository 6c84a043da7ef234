"""Files of a sensor's depth: which picture each belongs to, and which are told to be bad before any work."""

import cv2
import numpy as np
import pytest

from haustra.core.errors import HaustraError
from pipeline.config import Config, SensorSettings
from pipeline.input.sensor.sensor_depth import SensorDepth, check_sensor, open_sensor
from pipeline.run_folder.workspace import Workspace

COUNT = 30
SIDE = 40


def write_depth(folder, names):
    """Images of 30 mm in steps of 0.05 mm."""
    folder.mkdir()
    for name in names:
        cv2.imwrite(str(folder / name), np.full((SIDE, SIDE), 600, np.uint16))
    return SensorSettings(folder=str(folder), unit_mm=0.05)


@pytest.mark.parametrize(("first", "step", "depth_first"), [(1, 1, 1), (7, 2, 7), (1, 1, 0)])
def test_depth_belongs_to_the_picture_of_its_number(tmp_path, first, step, depth_first):
    """Where both are numbered alike, whatever stands before the number; else depth counts the frames from 0."""
    depth = {k: f"depth_{depth_first + step * k:05d}.png" for k in range(COUNT)}
    (tmp_path / "film").mkdir()
    for k in range(COUNT):
        cv2.imwrite(str(tmp_path / "film" / f"rgb_{first + step * k:06d}.png"), np.full((SIDE, SIDE, 3), 9, np.uint8))
    workspace = Workspace(tmp_path / "run")
    workspace.root.mkdir()
    config = Config(sensor=write_depth(tmp_path / "depth", depth.values()))
    workspace.record |= {"config": config.model_dump(mode="json"), "source": {"path": str(tmp_path / "film")}}
    workspace.finish("frames", content_box=[0, 0, SIDE, SIDE], source_size=[SIDE, SIDE])
    assert {k: path.name for k, path in open_sensor(workspace, SIDE).files.items()} == depth


def test_a_unit_without_depth_is_one_sentence(tmp_path):
    """It was passed over in silence, and the run had no millimetres."""
    with pytest.raises(HaustraError, match=r"--depth-unit-mm\), but no depth of .*: say where it is by --depth-folder"):
        check_sensor(tmp_path / "film.mp4", SensorSettings(unit_mm=0.1), COUNT)
    check_sensor(tmp_path / "film.mp4", SensorSettings(unit_mm=0.1, depth="none"), COUNT)


def test_the_largest_value_is_no_depth_and_is_told_once(tmp_path):
    """Sensors write it where nothing returns; taken for depth it would be the farthest wall."""
    settings = write_depth(tmp_path / "depth", [f"{k:05d}.png" for k in range(COUNT)])
    assert check_sensor(tmp_path / "film.mp4", settings, COUNT) == ""
    depth = np.full((SIDE, SIDE), 600, np.uint16)
    depth[: SIDE // 4] = 65535
    for path in (tmp_path / "depth").iterdir():
        cv2.imwrite(str(path), depth)
    told = check_sensor(tmp_path / "film.mp4", settings, COUNT)
    assert told.startswith("25 % of the values in 15 of the sensor's depth images are 65535, the largest of 16")
    files = {0: tmp_path / "depth" / "00000.png"}
    sensor = SensorDepth(files, settings, 0.05, (0, 0, SIDE, SIDE), 1.0, (SIDE, SIDE))
    found, _ = sensor.image(0)
    assert not found[: SIDE // 4].any()
    assert (found[SIDE // 4 :] == 30).all()
    cv2.imwrite(str(files[0]), np.full((SIDE, SIDE), 65535, np.uint16))
    with pytest.raises(HaustraError, match="hold no depth: all are 0 or 65535"):
        check_sensor(tmp_path / "film.mp4", SensorSettings(folder=str(only_first(tmp_path)), unit_mm=0.05), COUNT)


def only_first(folder):
    """A folder with the first depth image alone."""
    (folder / "one").mkdir()
    (folder / "one" / "00000.png").write_bytes((folder / "depth" / "00000.png").read_bytes())
    return folder / "one"


def test_one_bad_image_of_many_is_told_before_any_work(tmp_path):
    """Only some are read for their depth; the first and last bytes of all are."""
    settings = write_depth(tmp_path / "depth", [f"{k:05d}.png" for k in range(COUNT)])
    check_sensor(tmp_path / "film.mp4", settings, COUNT)
    path = tmp_path / "depth" / f"{COUNT - 1:05d}.png"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(HaustraError, match=f"{path.name} is a depth image that is cut off"):
        check_sensor(tmp_path / "film.mp4", settings, COUNT)
    cv2.imwrite(str(path), np.full((SIDE, SIDE), 9, np.uint8))
    with pytest.raises(HaustraError, match=f"{path.name} is no 16-bit depth image"):
        check_sensor(tmp_path / "film.mp4", settings, COUNT)
