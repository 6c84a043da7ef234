"""Calibration of a stereo rig: OpenCV's stereo YAML or XML (SCARED), the INI of the da Vinci sets (StereoMIS), and the
three text files of Hamlyn.

OpenCV: M1 D1 M2 D2 R T (or K1, cameraMatrix1, ...), where the second camera's point is R x + T. INI: [StereoLeft] and
[StereoRight] with fc_x fc_y cc_x cc_y kc_0 ... res_x res_y, and [StereoRight] R_0 ... R_8, T_0 ... T_2. Hamlyn:
camera_extrinsic.txt, three rows of R and one of T, and beside it Left_ and Right_Camera_Calibration_Intrinsic.txt,
three rows of K and one of distortion.
"""

import configparser
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import HaustraError
from haustra.core.text import read_text
from pipeline.input.camera_files.document import open_document

Array = NDArray[np.float64]
NAMES = {
    "first": ("m1", "k1", "cameramatrix1", "cameramatrixleft", "leftk"),
    "first_terms": ("d1", "distcoeffs1", "distortioncoefficientsleft", "distortion1", "leftd"),
    "second": ("m2", "k2", "cameramatrix2", "cameramatrixright", "rightk"),
    "second_terms": ("d2", "distcoeffs2", "distortioncoefficientsright", "distortion2", "rightd"),
    "turn": ("r", "rotation", "rotationmatrix"),
    "shift": ("t", "translation", "translationvector"),
}
HAMLYN = ("camera_extrinsic.txt", "camera_extrinsics.txt")
HAMLYN_EYES = ("left_camera_calibration_intrinsic.txt", "right_camera_calibration_intrinsic.txt")
METRES, MILLIMETRES = (5e-4, 0.02), (0.5, 20.0)  # ranges of a baseline; an endoscope's is 3 to 10 mm


@dataclass(frozen=True)
class StereoRig:
    """K (3,3) and distortion of both cameras, OpenCV's order and pixels; the second camera's point is turn x + shift,
    mm. size: (width, height) of one picture; None where the file does not say."""

    first: Array
    first_terms: Array
    second: Array
    second_terms: Array
    turn: Array
    shift: Array
    size: tuple[int, int] | None

    @property
    def baseline_mm(self) -> float:
        return float(np.linalg.norm(self.shift))


def read_rig(path: Path) -> StereoRig:
    """HaustraError, one sentence, for a file that is no stereo calibration."""
    if not path.is_file():
        raise HaustraError(f"there is no stereo calibration {path}")
    try:
        values = _values(path)
        rig = StereoRig(
            values["first"].reshape(3, 3),
            values["first_terms"].ravel(),
            values["second"].reshape(3, 3),
            values["second_terms"].ravel(),
            values["turn"].reshape(3, 3),
            _in_mm(values["shift"].ravel(), path),
            values["size"],
        )
    except HaustraError:
        raise
    except KeyError as error:
        raise HaustraError(f"{path} is no stereo calibration: it lacks {error.args[0]}") from error
    except (ValueError, TypeError, OverflowError, configparser.Error) as error:
        raise HaustraError(f"{path} is no stereo calibration that can be read: a value has another form") from error
    if not all(np.allclose([*matrix[2], matrix[1, 0]], [0, 0, 1, 0]) for matrix in (rig.first, rig.second)):
        raise HaustraError(f"{path}: a camera matrix is none: it must be fx 0 cx, 0 fy cy, 0 0 1, by rows")
    if not np.allclose(rig.turn @ rig.turn.T, np.eye(3), atol=1e-3) or np.linalg.det(rig.turn) < 0:
        raise HaustraError(f"{path}: the rotation between the cameras is none")
    return rig


def _values(path: Path) -> dict[str, Any]:
    if path.name.lower() in HAMLYN:
        return _three_files(path)
    document = open_document(path)
    return _ini(document.text) if path.suffix.lower() == ".ini" else _named(document.fields)


def _three_files(path: Path) -> dict[str, Any]:
    """Of Hamlyn: the rig's file, and each eye's beside it."""
    beside = {file.name.lower(): file for file in path.parent.iterdir()}
    missing = [name for name in HAMLYN_EYES if name not in beside]
    if missing:
        raise HaustraError(f"{path} is of Hamlyn's calibration, but beside it is no {' and no '.join(missing)}")
    (turn, shift), first, second = (_rows(file) for file in (path, *(beside[name] for name in HAMLYN_EYES)))
    names = ("first", "first_terms", "second", "second_terms", "turn", "shift")
    return dict(zip(names, (*first, *second, turn, shift), strict=True)) | {"size": None}


def _rows(path: Path) -> tuple[Array, Array]:
    """(3,3) of the first three rows, and the fourth row."""
    rows = [np.array(line.split(), np.float64) for line in read_text(path).splitlines() if line.strip()]
    if len(rows) < 4:
        raise HaustraError(f"{path} has {len(rows)} rows of numbers; Hamlyn's files have four")
    return np.stack(rows[:3]), rows[3]


def _named(fields: dict[str, Any]) -> dict[str, Any]:
    plain = {re.sub(r"[_\W]", "", name).lower(): value for name, value in fields.items()}
    found: dict[str, Any] = {}
    for wanted, names in NAMES.items():
        name = next((name for name in names if name in plain), None)
        if name is None:
            raise KeyError(names[0].upper())
        found[wanted] = np.asarray(plain[name], np.float64)
    width, height = plain.get("imagewidth", plain.get("leftwidth")), plain.get("imageheight", plain.get("leftheight"))
    found["size"] = (int(width), int(height)) if width and height else None
    return found


def _ini(text: str) -> dict[str, Any]:
    parser = configparser.ConfigParser()
    parser.read_string(text)
    left, right = parser["StereoLeft"], parser["StereoRight"]

    def camera(section: configparser.SectionProxy) -> tuple[Array, Array]:
        fx, fy, cx, cy = (section.getfloat(name) for name in ("fc_x", "fc_y", "cc_x", "cc_y"))
        terms = [section.getfloat(f"kc_{k}", 0.0) for k in range(5)]
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], float), np.array(terms, float)

    first, second = camera(left), camera(right)
    turn = np.array([right.getfloat(f"R_{k}") for k in range(9)], float)
    shift = np.array([right.getfloat(f"T_{k}") for k in range(3)], float)
    size = (left.getint("res_x"), left.getint("res_y")) if "res_x" in left else None
    names = ("first", "first_terms", "second", "second_terms", "turn", "shift", "size")
    return dict(zip(names, (*first, *second, turn, shift, size), strict=True))


def _in_mm(shift: Array, path: Path) -> Array:
    length = float(np.linalg.norm(shift))
    if MILLIMETRES[0] <= length <= MILLIMETRES[1]:
        return shift
    if METRES[0] <= length <= METRES[1]:
        return 1000 * shift
    raise HaustraError(
        f"{path} has its cameras {length:.3g} apart, which is no endoscope's baseline, neither in mm nor in m"
    )
