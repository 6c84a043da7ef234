"""EndoMapper's `Endoscope_XX_photometrical.xml`: the lamp of the scope whose lens is in `Endoscope_XX_geometrical.xml`.

Of the camera `gamma` and `vignetting`, of the light (`sls`) its spread `mu` and axis `D`; its strength `sigma` drops
out with each frame's exposure, and its place `P` is not used. Numbers stand in brackets, parted by semicolons.
"""

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from haustra.core.errors import HaustraError
from haustra.core.text import read_text
from reconstruction.fusion.lamp import Lamp


def read_lamp(path: Path) -> Lamp:
    """HaustraError, one sentence, for a file that is no photometric calibration."""
    try:
        rig = ElementTree.fromstring(read_text(path))
    except ElementTree.ParseError as error:
        raise HaustraError(f"{path} is not whole XML ({error})") from error
    camera, light = rig.find(".//camera_model[@type='gamma']"), rig.find(".//light_model[@type='sls']")
    if camera is None or light is None:
        kinds = "a camera 'gamma' or a light 'sls'"
        raise HaustraError(f"{path} is no photometric calibration of EndoMapper: it lacks {kinds}")
    axis = np.array(_numbers(light, "D", path))
    (spread,), (gamma,) = _numbers(light, "mu", path)[:1], _numbers(camera, "gamma", path)[:1]
    (vignetting,) = _numbers(camera, "vignetting", path)[:1] if camera.find("vignetting") is not None else [0.0]
    length = float(np.linalg.norm(axis))
    if len(axis) != 3 or not abs(length - 1) < 0.01 or axis[2] <= 0 or spread < 0 or not 1 <= gamma <= 4:
        raise HaustraError(
            f"{path}: a lamp with axis {axis.tolist()}, spread {spread:g} and gamma {gamma:g} is none of an endoscope"
        )
    x, y, z = (axis / length).tolist()
    return Lamp((x, y, z), spread, vignetting, gamma)


def _numbers(model: ElementTree.Element, name: str, path: Path) -> list[float]:
    found = [float(word) for word in re.findall(r"[-+]?\d*\.?\d+(?:[eE][-+]?\d+)?", model.findtext(name) or "")]
    if not found:
        raise HaustraError(f"{path} lacks the numbers of <{name}>")
    return found
