"""EndoMapper's photometric file, as its calibration program writes it (`save_calib_xml`), and what cannot be one."""

from pathlib import Path

import numpy as np
import pytest

from haustra.core.errors import HaustraError
from pipeline.config import Config, FusionSettings
from pipeline.run_folder.inputs import inputs_of
from pipeline.surface.fusion_stage import _recorded_illumination
from pipeline.surface.lamp_file import read_lamp
from reconstruction.fusion.lamp import Lamp

FILE = """<rig>
    <camera>
        <camera_model name="" index="0" serialno="0" type="gamma" version="1.0">
            <!-- Camera response model -->
            <gamma> [ 2.2 ] </gamma>
            <vignetting> [ 1.250000 ] </vignetting>
        </camera_model>
    </camera>
    <light>
        <light_model name="" index="0" serialno="0" type="sls" version="1.0">
            <!-- main intensity value -->
            <sigma> 1.000000 </sigma>
            <mu> 2.746439 </mu>
            <P> [ -0.001; 0.004; 0.000 ] </P>
            <D> [ 0.003184; 0.000000; 0.999995 ] </D>
        </light_model>
    </light>
</rig>
"""


def config(camera, lamp="auto"):
    return Config(camera=str(camera), fusion=FusionSettings(lamp=lamp))


def test_the_lamp_lies_beside_the_lens(tmp_path):
    lens = tmp_path / "Endoscope_02_geometrical.xml"
    assert config(lens).lamp_file is None
    (tmp_path / "Endoscope_02_photometrical.xml").write_text(FILE)
    lamp = read_lamp(config(lens).lamp_file)
    assert (lamp.spread, lamp.vignetting, lamp.gamma) == (2.746439, 1.25, 2.2)
    np.testing.assert_allclose(lamp.axis, [0.003184, 0, 0.999995], atol=1e-6)
    assert config(lens, "none").lamp_file is None
    named = str(tmp_path / "Endoscope_02_photometrical.xml")
    assert read_lamp(config("auto", named).lamp_file) == lamp
    assert config("endomapper-02").lamp_file is None
    assert inputs_of(tmp_path / "film.mp4", config(lens))["lamp file"] == Path(named)  # a change of it is noticed


def test_its_emission_is_that_of_the_spot_light():
    """e^(-mu (1 - D . L)) of Modrzejewski et al., times the lens's cosine power, at 30 degrees off the axis."""
    ray = np.array([np.sin(np.pi / 6), 0, np.cos(np.pi / 6)], np.float32)
    found = float(np.exp(Lamp((0, 0, 1), 2.0, 1.5).log_emission(ray)))
    assert found == pytest.approx(np.exp(-2 * (1 - np.cos(np.pi / 6))) * np.cos(np.pi / 6) ** 1.5, rel=1e-5)


def test_a_run_keeps_the_lamp_that_was_used():
    values = {"distance": -2.0, "slant": 1.0, "axis": 1.0, "level": 0.1, "reference": 9.0, "frames": 4}
    stored = values | {"lamp": {"axis": [0.0, 0.0, 1.0], "spread": 2.0, "vignetting": 0.0, "gamma": 2.2}}
    assert _recorded_illumination(stored).lamp == Lamp((0.0, 0.0, 1.0), 2.0)
    assert _recorded_illumination(values).lamp is None  # of a run before lamps were read


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("</rig>", "", "not whole XML"),
        ('type="sls"', 'type="point"', "lacks a camera 'gamma' or a light 'sls'"),
        ("<mu> 2.746439 </mu>", "", "lacks the numbers of <mu>"),
        ("0.999995", "-0.999995", "none of an endoscope"),
        ("0.999995", "0.2", "none of an endoscope"),
    ],
)
def test_what_is_no_photometric_calibration(tmp_path, old, new, said):
    (tmp_path / "lamp.xml").write_text(FILE.replace(old, new))
    with pytest.raises(HaustraError, match=said):
        read_lamp(tmp_path / "lamp.xml")
