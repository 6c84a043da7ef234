"""Published intrinsics of endoscopes and simulators, each with its source; lens as calibrated by its authors."""

from dataclasses import dataclass

from haustra.core.camera import Camera
from haustra.core.lenses.scaramuzza import parameters_of
from pipeline.input.endomapper_scopes import LENSES, endomapper_camera, mean_colonoscope

HALF_PIXEL = 0.5  # from the centre of the first pixel, where OpenCV counts from, to its corner


@dataclass(frozen=True)
class Preset:
    """A camera at its calibrated size, and where the numbers come from."""

    camera: Camera
    source: str


PRESETS = {
    "c3vd": Preset(
        Camera(
            "SCARAMUZZA",
            1350,
            1080,
            parameters_of(
                769.243600037458,
                -0.000812770624150226,
                6.25674244578925e-07,
                -1.19662182144280e-09,
                (678.544839263292 + HALF_PIXEL, 542.975887548343 + HALF_PIXEL),
                (0.99998688224999, 0.00288273829525059, -0.00296316513429569),
            ),
        ),
        "C3VD, Olympus CF-HQ190L, Scaramuzza calibration of the data set's own program (DurrLab/C3VD)",
    ),
    "c3vd-v2": Preset(
        Camera(
            "SCARAMUZZA",
            1350,
            1080,
            parameters_of(
                767.7337,
                -5.92506e-4,
                -2.6944e-7,
                -2.1638e-10,
                (677.7395 + HALF_PIXEL, 543.058 + HALF_PIXEL),
                (0.9999, 1.1e-4, -1.83e-4),
            ),
        ),
        "C3VDv2, Olympus CF-HQ190L, Scaramuzza calibration of the data set",
    ),
    "c3vd-opencv": Preset(
        Camera(
            "OPENCV",
            1350,
            1080,
            (802.319, 801.885, 668.286 + HALF_PIXEL, 547.733 + HALF_PIXEL, -0.42234, 0.10654, 0.0, 0.0),
        ),
        "C3VD, the authors' OpenCV approximation (issue 2 of DurrLab/C3VD), poor at the periphery; COLMAP knows it",
    ),
    "colonoscope": Preset(mean_colonoscope(), "mean of the 18 colonoscopes of EndoMapper"),
    "endomapper-sim": Preset(
        # The data set's 479.5 and 359.5 are the middle of 960x720 counted from the centre of the first pixel.
        Camera("PINHOLE", 960, 720, (472.64955, 472.64955, 480.0, 360.0)),
        "EndoMapper simulated sequences",
    ),
    "simcol3d": Preset(
        # Unity's camera looks through the middle of its picture: cam.txt's 237.5 = 475 / 2 counts from the corner.
        Camera("PINHOLE", 475, 475, (227.60416, 227.60416, 237.5, 237.5)),
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
} | {
    f"endomapper-{number:02d}": Preset(
        endomapper_camera(number), f"EndoMapper Endoscope_{number:02d}, Kannala-Brandt calibration file of the data set"
    )
    for number in LENSES
}
