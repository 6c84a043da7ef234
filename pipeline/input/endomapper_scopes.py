"""Lenses of the 18 colonoscopes of the EndoMapper data set (Azagra et al., Scientific Data 2023), at 1440x1080.

fx fy cx cy k1 k2 k3 k4 of Kannala and Brandt, from the data set's `Endoscope_XX_geometrical.xml`. The files do not say
from where their pixels count; ORB-SLAM3's authors' settings for them use OpenCV's convention.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from haustra.core.camera import Camera

SIZE = (1440, 1080)
HALF_PIXEL = 0.5

LENSES: dict[int, tuple[float, ...]] = {
    1: (717.6911, 718.0214, 734.7278, 552.0724, -0.1396589, -0.0003139987, 0.001505504, -0.0001316715),
    2: (731.4255, 732.5445, 737.7475, 528.234, -0.1266367, -0.007181695, 0.001811004, -8.435985e-05),
    3: (726.7941, 727.7907, 742.7416, 542.1428, -0.1289632, -0.006051189, 0.001660961, -7.847858e-05),
    4: (733.0653, 734.3432, 743.3353, 539.6794, -0.1273872, -0.006822601, 0.001757994, -8.190911e-05),
    5: (725.0401, 725.4004, 732.6413, 532.2588, -0.1243021, -0.009060777, 0.002216455, -0.0001106586),
    6: (732.05, 733.627, 750.7783, 540.2329, -0.1227168, -0.008291064, 0.001918722, -8.79486e-05),
    7: (727.1851, 728.5954, 738.1817, 537.4003, -0.1311029, -0.005149247, 0.001512357, -6.998448e-05),
    8: (732.1237, 732.2724, 744.0782, 533.7642, -0.1234479, -0.009313484, 0.002108185, -9.557961e-05),
    9: (722.4501, 724.7698, 733.9647, 531.8775, -0.1239732, -0.008013424, 0.001897534, -8.726712e-05),
    10: (732.4306, 734.353, 738.311, 539.3893, -0.1212004, -0.006871399, -0.002413982, 0.0003381683),
    11: (779.7726, 781.3549, 732.8386, 542.7877, -0.1173549, -0.01065752, 0.002246621, -0.0001026692),
    12: (798.7009, 800.8594, 762.7805, 534.0589, -0.1226875, -0.008255254, 0.001903445, -8.668923e-05),
    13: (785.2939, 786.5119, 735.3552, 527.0021, -0.11391, -0.01307144, 0.002729462, -0.0001323343),
    14: (778.093, 779.8972, 758.6881, 522.723, -0.1163844, -0.01293961, 0.002741617, -0.0001316264),
    15: (785.2521, 786.6768, 741.1905, 542.8783, -0.1234686, -0.008368, 0.001964611, -9.119877e-05),
    16: (781.8292, 783.2562, 749.186, 546.9903, -0.1196276, -0.009985036, 0.002201601, -0.0001030625),
    17: (784.9731, 787.4725, 768.3014, 525.7337, -0.1152314, -0.01349485, 0.002825019, -0.000135791),
    18: (792.4682, 793.8657, 752.0146, 538.7447, -0.1225753, -0.008555882, 0.001950166, -8.838763e-05),
}


def endomapper_camera(number: int) -> Camera:
    """The lens of one colonoscope."""
    return _camera(LENSES[number])


def mean_colonoscope() -> Camera:
    """The lens whose radius at each angle is the mean of all: terms weigh by their focal length. Not trusted: each
    colonoscope is its own, and the lens is refined."""
    lenses = np.array(list(LENSES.values()))
    mean = lenses.mean(axis=0)
    focal = np.sqrt(lenses[:, 0] * lenses[:, 1])
    terms = (focal[:, None] * lenses[:, 4:]).mean(axis=0) / focal.mean()
    return replace(_camera([*mean[:4], *terms]), trusted=False)


def _camera(lens: Sequence[float]) -> Camera:
    fx, fy, cx, cy, *terms = (float(value) for value in lens)
    return Camera("OPENCV_FISHEYE", *SIZE, (fx, fy, cx + HALF_PIXEL, cy + HALF_PIXEL, *terms))
