"""EndoMapper's `Endoscope_XX_geometrical.xml`: a calibu rig, whose numbers are text between brackets, by semicolons."""

import xml.etree.ElementTree as ElementTree

from haustra.core.errors import HaustraError
from haustra.core.lenses.scaramuzza import parameters_of
from pipeline.input.camera_files.calibrated_lens import HALF_PIXEL, CalibratedLens, from_opencv
from pipeline.input.camera_files.document import CameraDocument

PINHOLE = "calibu_fu_fv_u0_v0"
RADIAL = "calibu_fu_fv_u0_v0_k1_k2"
FISHEYE = "calibu_fu_fv_u0_v0_kb4"
OMNI = "ocamcalib_cx_cy_a0_a2_a3_a4_e_f_g"
LAMP = ("gamma", "sls")


def read_endomapper(document: CameraDocument) -> CalibratedLens | None:
    if not document.text.lstrip("\ufeff \t\r\n").startswith("<") or "<camera_model" not in document.text:
        return None
    try:
        rig = ElementTree.fromstring(document.text)
    except ElementTree.ParseError as error:
        raise HaustraError(f"it is not whole XML ({error})") from error
    model = next(rig.iter("camera_model"))
    kind = model.get("type", "")
    if kind in LAMP:
        raise HaustraError("it is a photometric calibration; the lens is in the file ..._geometrical.xml beside it")
    numbers = [float(word) for word in _text(model, "params").strip("[] \n\t").replace(";", " ").split()]
    size = int(_text(model, "width")), int(_text(model, "height"))
    if kind == OMNI:
        cx, cy, a0, a2, a3, a4, c, d, e = numbers
        centre = cx + HALF_PIXEL, cy + HALF_PIXEL
        return CalibratedLens("SCARAMUZZA", parameters_of(a0, a2, a3, a4, centre, (c, d, e)), size)
    if kind not in (PINHOLE, RADIAL, FISHEYE):
        raise HaustraError(f"its camera model {kind!r} is none of {', '.join((PINHOLE, RADIAL, FISHEYE, OMNI))}")
    fx, fy, cx, cy, *terms = numbers
    return from_opencv(fx, fy, cx, cy, terms, size, kind == FISHEYE)


def _text(model: ElementTree.Element, name: str) -> str:
    found = model.findtext(name)
    if found is None:
        raise HaustraError(f"it lacks <{name}>")
    return found
