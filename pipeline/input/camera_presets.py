"""Published intrinsics of endoscopes and simulators, each with its source; lens as calibrated by its authors."""

from dataclasses import dataclass

from haustra.core.camera import Camera


@dataclass(frozen=True)
class Preset:
    """A camera at its calibrated size, and where the numbers come from."""

    camera: Camera
    source: str


PRESETS = {
    "c3vd": Preset(
        Camera(
            "OPENCV",
            1350,
            1080,
            (802.319, 801.885, 668.286, 547.733, -0.42234, 0.10654, 0.0, 0.0),
        ),
        "C3VD, Olympus CF-HQ190L; the authors' OpenCV approximation (issue 2 of DurrLab/C3VD), poor at the periphery",
    ),
    "endomapper-03": Preset(
        Camera(
            "OPENCV_FISHEYE",
            1440,
            1080,
            (726.79, 727.79, 742.74, 542.14, -0.12896, -0.006051, 0.001661, -7.85e-5),
        ),
        "EndoMapper Endoscope_03, Kannala-Brandt calibration file of the data set",
    ),
    "endomapper-sim": Preset(
        Camera("PINHOLE", 960, 720, (472.65, 472.65, 480.0, 360.0)), "EndoMapper simulated sequences"
    ),
    "simcol3d": Preset(
        # cx and cy of the data set count from the centre of the first pixel; COLMAP counts from its corner.
        Camera("PINHOLE", 475, 475, (227.604, 227.604, 238.0, 238.0)),
        "SimCol3D challenge, cam.txt",
    ),
    "endoslam-unitycam": Preset(
        Camera(
            "OPENCV",
            320,
            320,
            (156.0418, 155.7529, 178.5604, 181.8043, -0.2486, 0.0614, 0.0, 0.0),
        ),
        "EndoSLAM UnityCam, as used by several repositories; not stated by the data set",
    ),
    "vr-caps": Preset(
        Camera("PINHOLE", 320, 320, (159.45, 159.45, 160.0, 160.0)),
        "VR-Caps as set up in the MSCSA-Net paper, section III-A (focal length 159.45, 320x320)",
    ),
    "csd": Preset(
        Camera("PINHOLE", 480, 640, (232.5045, 232.5045, 240.0, 320.0)),
        "Zhang's colonoscopy simulator data set (zsustc/colon_reconstruction_dataset)",
    ),
}
