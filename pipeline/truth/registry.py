"""The data sets whose truth is read as it lies on disk. A new one is a file with its reader and a row here."""

from collections.abc import Callable
from pathlib import Path

from pipeline.truth.c3vd import read_c3vd
from pipeline.truth.data_set_truth import DataSetTruth
from pipeline.truth.endomapper_sim import read_endomapper_sim
from pipeline.truth.laparoscopes import read_hamlyn, read_scared, read_stereomis
from pipeline.truth.simcol3d import read_simcol3d

# A reader gives None for a folder of another layout.
TRUTH_READERS: dict[str, Callable[[Path], DataSetTruth | None]] = {
    "C3VD, C3VDv2 (pose.txt)": read_c3vd,
    "SimCol3D (SavedPosition_*.txt beside the folder)": read_simcol3d,
    "EndoMapper simulated (trajectory.csv)": read_endomapper_sim,
    "SCARED (data/frame_data of a keyframe)": read_scared,
    "StereoMIS (groundtruth.txt, StereoCalibration.ini)": read_stereomis,
    "Hamlyn (depth01, without a path)": read_hamlyn,
}


def read_data_set_truth(folder: Path) -> DataSetTruth | None:
    """The truth of a data set's folder; None where it is of no known layout."""
    return next((truth for read in TRUTH_READERS.values() if (truth := read(folder)) is not None), None)
