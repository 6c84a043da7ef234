"""A camera matrix as nine numbers of plain text, and its distortion below it or in a file beside it.

scikit-surgery and NiftyCal: `calib.left.intrinsics.txt` with `calib.left.distortion.txt`, or both in the first file.
EndoSLAM and MATLAB users: the nine numbers on one line, by rows or, as MATLAB stores it, by columns.
"""

import re
from pathlib import Path

import numpy as np

from haustra.core.errors import HaustraError
from haustra.core.text import read_text
from pipeline.input.camera_files.calibrated_lens import CalibratedLens, from_matrix
from pipeline.input.camera_files.document import CameraDocument

ENTRIES = 9
SIMCOL3D = (227.60416, 0, 227.60416, 0, 237.5, 237.5, 0, 0, 1)  # its cam.txt, whose third number should be 237.5
BESIDE = (("intrinsics", "distortion"), ("intrinsic", "distortion"))


def read_text_matrix(document: CameraDocument) -> CalibratedLens | None:
    numbers = _numbers(document.text)
    if numbers and len(numbers) < ENTRIES and "distortion" in document.path.name:
        raise HaustraError("it holds distortion terms alone; give the file of the camera matrix, which finds this one")
    if numbers is None or len(numbers) < ENTRIES:
        return None
    matrix, terms = np.array(numbers[:ENTRIES]).reshape(3, 3), numbers[ENTRIES:]
    # By its own numbers: of a camera of 90 degrees, too, the third number is the focal length.
    if np.allclose(matrix.ravel(), SIMCOL3D, rtol=0, atol=1e-3):
        raise HaustraError(
            "its third number repeats the focal length, a slip of SimCol3D's cam.txt; take --camera simcol3d"
        )
    if matrix[0, 2] == matrix[1, 2] == 0 and matrix[2, 0] > 0:  # by columns
        matrix = matrix.T
    if matrix[2].tolist() != [0, 0, 1] or matrix[1, 0] != 0:
        return None
    if len(terms) not in (0, 4, 5, 8):
        return None
    if terms:
        return from_matrix(matrix, terms, None)
    path = _beside(document.path)
    return from_matrix(matrix, _terms(path) if path else [], None, note=f"with {path.name}" if path else "")


def _beside(path: Path) -> Path | None:
    """The file of the distortion terms, where there is one."""
    for name, other in BESIDE:
        if name in path.name and path.with_name(path.name.replace(name, other)).is_file():
            return path.with_name(path.name.replace(name, other))
    return None


def _terms(path: Path) -> list[float]:
    numbers = _numbers(read_text(path))
    if not numbers:
        raise HaustraError(f"{path.name} beside it must hold the distortion terms as numbers")
    return numbers


def _numbers(text: str) -> list[float] | None:
    """All of a text that holds nothing but numbers; None of another one. Lines that begin with # are comments."""
    lines = [line for line in text.splitlines() if not line.lstrip().startswith("#")]
    words = re.split(r"[\s,;]+", " ".join(lines).strip())
    try:
        return [float(word) for word in words if word]
    except ValueError:
        return None
