"""EndoMapper's simulated sequences: `trajectory.csv`, tX;tY;tZ;rX;rY;rZ;rW;time, of a left-handed Unity world.

Its `info.txt` says decimetres, which users doubt (issue 152 of VSLAM-LAB): a scale against it is to be read with care,
and no surface is made of its depth.
"""

from pathlib import Path

from haustra.core.text import read_text
from pipeline.truth.data_set_truth import DataSetTruth, rotations_of, table_of
from pipeline.truth.simcol3d import right_handed

COLUMNS = "tx;ty;tz;rx;ry;rz;rw;time"
MM_PER_DM = 100.0


def read_endomapper_sim(folder: Path) -> DataSetTruth | None:
    path = folder / "trajectory.csv"
    if not path.is_file():
        return None
    head = read_text(path).partition("\n")[0]
    if head.strip().lower().replace(" ", "") != COLUMNS:
        return None
    table = table_of(path, 8, ";", skip=1)
    rotations = rotations_of(path, table[:, 3:7])
    return DataSetTruth(right_handed(MM_PER_DM * table[:, :3], rotations), seconds=table[:, 7] - table[0, 7])
