"""Settings of ORB-SLAM2 and 3, NR-SLAM, DefSLAM and pySLAM: `Camera.fx`, `Camera1.fx`, `Camera.type`.

Files without a type have k1 k2 p1 p2 [k3], or a Kannala-Brandt lens's k1 to k4 and no p1. NR-SLAM counts from k0.
"""

from typing import Any

from haustra.core.errors import HaustraError
from pipeline.input.camera_files.calibrated_lens import CalibratedLens, from_opencv, size_of
from pipeline.input.camera_files.document import CameraDocument

FISHEYE = ("kannalabrandt8", "kannalabrandt")
PINHOLE = ("pinhole", "rectified", "perspective")


def read_orb_slam(document: CameraDocument) -> CalibratedLens | None:
    fields = document.fields
    prefix = next((one for one in ("Camera1", "Camera") if f"{one}.fx" in fields), None)
    if prefix is None:
        return None
    fx, fy, cx, cy = (float(fields[f"{prefix}.{name}"]) for name in ("fx", "fy", "cx", "cy"))
    terms, fisheye, note = _distortion(fields, prefix)
    return from_opencv(fx, fy, cx, cy, terms, size_of(fields, "Camera.width", "Camera.height"), fisheye, note)


def _distortion(fields: dict[str, Any], prefix: str) -> tuple[list[float], bool, str]:
    def term(name: str) -> float:
        return float(fields.get(f"{prefix}.{name}", 0))

    kind = str(fields.get("Camera.type", fields.get("Camera.model", ""))).lower()
    if kind and kind not in (*FISHEYE, *PINHOLE):
        raise HaustraError(f"its camera is {kind!r}; PinHole, Rectified and KannalaBrandt8 can be read")
    guessed = not kind and f"{prefix}.k4" in fields and f"{prefix}.p1" not in fields
    if kind in FISHEYE or guessed:
        first = 0 if f"{prefix}.k0" in fields else 1
        note = "it names no type; k1 to k4 without p1 were taken for Kannala and Brandt's" if guessed else ""
        return [term(f"k{first + k}") for k in range(4)], True, note
    return [term(name) for name in ("k1", "k2", "p1", "p2", "k3")], False, ""
