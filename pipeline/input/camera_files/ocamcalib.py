"""Scaramuzza's polynomial lens: `calib_results.txt` of OCamCalib, and C3VD's line of eleven numbers.

OCamCalib has the polynomial a0 a1 a2 ... with its axis towards the camera, the centre as row and column counted from
(0, 0), and the pixel as (row, column). C3VD's line is `width height cx cy a0 a2 a3 a4 c d e` as MATLAB's
fisheyeIntrinsics has them, whose pixels count from (1, 1): C3VD's own program takes one off.
"""

from haustra.core.errors import HaustraError
from haustra.core.lenses.scaramuzza import parameters_of
from pipeline.input.camera_files.calibrated_lens import HALF_PIXEL, CalibratedLens
from pipeline.input.camera_files.document import CameraDocument

LINE = 11
MATLAB_FIRST = 1.0


def read_ocamcalib(document: CameraDocument) -> CalibratedLens | None:
    if "polynomial coefficients for the DIRECT" in document.text:
        return _calib_results(document.text)
    words = document.text.replace(",", " ").split()
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        return None
    if len(numbers) != LINE or not all(side.is_integer() and side > 0 for side in numbers[:2]):
        return None
    width, height, cx, cy, a0, a2, a3, a4, c, d, e = numbers
    centre = cx - MATLAB_FIRST + HALF_PIXEL, cy - MATLAB_FIRST + HALF_PIXEL
    return CalibratedLens(
        "SCARAMUZZA", parameters_of(a0, a2, a3, a4, centre, (c, d, e)), (int(width), int(height)), "pixels from (1, 1)"
    )


def _calib_results(text: str) -> CalibratedLens:
    lines = [line.split() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if len(lines) < 5:
        raise HaustraError("it lacks one of: polynomial, inverse polynomial, centre, affine parameters, size")
    direct, _, centre, affine, size = lines[:5]
    count, a0, a1, *more = (float(word) for word in direct)
    a2, a3, a4, *rest = (*more, 0.0, 0.0, 0.0)[: max(3, len(more))]
    if count != len(direct) - 1 or a1 != 0 or any(rest):
        raise HaustraError("its polynomial must have a0, a1 = 0, a2, a3 and a4, and no more")
    row, column = (float(word) for word in centre)
    c, d, e = (float(word) for word in affine)
    height, width = (int(word) for word in size)
    # (row, column) = [[c, d], [e, 1]] (x, y), so (column, row) = [[1, e], [d, c]] (y, x): over c that has our form, of
    # a ray whose first two components are c times as long.
    polynomial = (-a0 * c, -a2 / c, -a3 / c**2, -a4 / c**3)
    centre_px = (column + HALF_PIXEL, row + HALF_PIXEL)
    return CalibratedLens("SCARAMUZZA", parameters_of(*polynomial, centre_px, (1 / c, e / c, d / c)), (width, height))
