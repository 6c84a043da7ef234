"""Lens models: how a camera's ray becomes a point of its picture.

A model is a file and a row in `LENS_MODELS` (docs/extending.md).
"""

from haustra.core.lenses.brown import distort as _brown
from haustra.core.lenses.brown import first_guess as _brown_guess
from haustra.core.lenses.brown import valid_angle as _brown_limit
from haustra.core.lenses.kannala_brandt import distort as _kannala_brandt
from haustra.core.lenses.kannala_brandt import first_guess as _kannala_brandt_guess
from haustra.core.lenses.kannala_brandt import valid_angle as _kannala_brandt_limit
from haustra.core.lenses.model import LensModel
from haustra.core.lenses.scaramuzza import distort as _scaramuzza
from haustra.core.lenses.scaramuzza import undistort as _scaramuzza_inverse
from haustra.core.lenses.scaramuzza import valid_angle as _scaramuzza_limit


def _polynomial(parameters: int, focal_lengths: int) -> LensModel:
    return LensModel(parameters, focal_lengths, _brown, _brown_guess, _brown_limit)


def _fisheye(parameters: int, focal_lengths: int) -> LensModel:
    model = _kannala_brandt, _kannala_brandt_guess, _kannala_brandt_limit
    return LensModel(parameters, focal_lengths, *model, widest=1.9, straight_at_zero=False)


# By COLMAP's names and in COLMAP's order of parameters: focal length(s), centre x and y, distortion. COLMAP has no
# SCARAMUZZA: a0, centre x and y, b2, b3, b4, c, d, e.
LENS_MODELS: dict[str, LensModel] = {
    "SIMPLE_PINHOLE": _polynomial(3, 1),
    "PINHOLE": _polynomial(4, 2),
    "SIMPLE_RADIAL": _polynomial(4, 1),
    "RADIAL": _polynomial(5, 1),
    "OPENCV": _polynomial(8, 2),
    "FULL_OPENCV": _polynomial(12, 2),
    "SIMPLE_RADIAL_FISHEYE": _fisheye(4, 1),
    "RADIAL_FISHEYE": _fisheye(5, 1),
    "OPENCV_FISHEYE": _fisheye(8, 2),
    "SCARAMUZZA": LensModel(
        9,
        1,
        _scaramuzza,
        _brown_guess,
        _scaramuzza_limit,
        widest=1.9,
        straight_at_zero=False,
        in_colmap=False,
        undistort=_scaramuzza_inverse,
    ),
}
