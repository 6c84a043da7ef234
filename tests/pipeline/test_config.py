"""Settings by their old names: what version 0.1 wrote is read, what it could do and we cannot is said."""

from pathlib import Path

import pydantic
import pytest
import yaml

from haustra import Config, reconstruct
from haustra.core.errors import HaustraError
from haustra.core.unique_yaml import load_unique
from pipeline.config import load_config, read_recorded, retired_differences, validate_config
from pipeline.retired_settings import FIXED, RETIRED
from pipeline.surface.fusion_stage import TRUNCATION_VOXELS

OLD = yaml.safe_load((Path(__file__).parent / "old_run_settings.yaml").read_text())

# Defaults that are others since.
AS_IT_WAS = load_config(
    None,
    depth={"keyframe_motion": 0.02},
    consistency={"steps": [2, 5, 10]},
    fusion={"min_observations": 2},
)


def test_the_record_of_an_old_run_is_read():
    assert read_recorded(OLD) == AS_IT_WAS
    assert retired_differences(OLD) == []


def test_retired_values_are_those_of_version_0_1():
    assert {name: OLD[section][key] for name in RETIRED for section, key in [name.split(".")]} == RETIRED


@pytest.mark.parametrize(
    ("values", "name", "truth"),
    [
        ({"seed": True}, "seed", "true"),
        ({"frames": {"end_s": False}}, "frames.end_s", "false"),
        ({"consistency": {"steps": [True, 2]}}, "consistency.steps", "true"),
    ],
)
def test_true_and_false_are_no_numbers(values, name, truth):
    with pytest.raises(HaustraError, match=f"setting '{name}': {truth} is no number; give one"):
        validate_config(values)
    assert validate_config({"depth": {"multiview": True}}).depth.multiview


@pytest.mark.parametrize("said", [{"layout": "over-under"}, {"right": "right.mp4"}])
def test_what_is_said_of_a_second_eye_needs_its_calibration(said):
    """The film would be taken as one of one eye, its two pictures as one."""
    with pytest.raises(HaustraError, match=r"--stereo-right\) needs the calibration of both \(--stereo\)"):
        validate_config({"stereo": said})
    assert validate_config({"stereo": said | {"calibration": "rig.yaml"}}).stereo.calibration == "rig.yaml"


def test_old_names_keep_their_values():
    old = OLD | {
        "pose_graph": OLD["pose_graph"] | {"max_places": 7, "join": False},
        "depth": OLD["depth"] | {"looks": 1},
    }
    config = read_recorded(old)
    assert (config.loop_closing.max_keyframes, config.loop_closing.merge_submaps) == (7, False)
    assert config.depth.iterations == 1


def test_a_retired_setting_that_was_changed_is_another_run():
    changed = OLD | {"depth": OLD["depth"] | {"max_fov_deg": 90.0}}
    assert retired_differences(changed) == ["depth.max_fov_deg: 90.0, now fixed at 120"]
    assert read_recorded(changed) == AS_IT_WAS


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("pose_graph: {per_place: 3}", "no setting 'pose_graph.per_place' any more, it is fixed at 3; remove it"),
        ("structure: {max_features: 4096}", "'structure.max_features' any more, it is fixed at 2048; remove it"),
        ("pose_graph: {typo: 1}", "no setting 'pose_graph.typo'"),
        ("depth: {typo: 1}", "no setting 'depth.typo'"),
    ],
)
def test_a_settings_file_with_a_retired_name_is_refused(tmp_path, text, sentence):
    (tmp_path / "settings.yaml").write_text(text)
    with pytest.raises(HaustraError, match=sentence):
        load_config(tmp_path / "settings.yaml")


def test_a_settings_file_may_use_renamed_settings(tmp_path):
    (tmp_path / "settings.yaml").write_text("pose_graph: {enabled: false}\ndepth: {looks: 2}\n")
    config = load_config(tmp_path / "settings.yaml")
    assert (config.loop_closing.enabled, config.depth.iterations) == (False, 2)


def test_a_replaced_setting_is_named_with_its_successor_and_left_out_of_old_records():
    with pytest.raises(HaustraError, match=r"'fusion.max_depth_ratio' any more, 'fusion.max_error_voxels' has taken"):
        validate_config({"fusion": {"max_depth_ratio": 2.0}})
    assert read_recorded({"fusion": {"max_depth_ratio": 3.0, "min_observations": 1}}).fusion.min_observations == 1


@pytest.mark.parametrize(
    "text",
    ["&a {b: *a}", "frames: &a\n  b: *a", "seed: " + 5000 * "1", "3: 4", "frames: {12: 5}", "- frames", "[" * 3000],
)
def test_a_settings_file_of_other_yaml_is_one_sentence(tmp_path, text):
    (tmp_path / "settings.yaml").write_text(text)
    with pytest.raises(HaustraError, match=r"the configuration .*settings.yaml") as told:
        load_config(tmp_path / "settings.yaml")
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("diameter", [0.05, 0, -3, 5000])
def test_a_lumen_of_another_unit_is_refused(diameter):
    with pytest.raises(HaustraError, match=f"setting 'lumen_mm': no endoscope films a lumen of {diameter:g} mm"):
        load_config(None, lumen_mm=diameter)
    assert load_config(None, lumen_mm=50).lumen_mm == 50


def test_a_retired_setting_fixed_anew_differs_neither_by_its_old_default_nor_by_its_value_of_today():
    for voxels, differences in (12.0, []), (5.0, []), (8.0, ["fusion.truncation_voxels: 8.0, now fixed at 5"]):
        assert retired_differences({"fusion": {"truncation_voxels": voxels}}) == differences
    with pytest.raises(HaustraError, match="fixed at 5; remove it"):
        validate_config({"fusion": {"truncation_voxels": 12.0}})
    assert FIXED["fusion.truncation_voxels"] == TRUNCATION_VOXELS


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("frames: {start_s: 60}\nseed: 1\nframes: {stride: 2}\n", r"'frames' stands twice, on lines 1 and 3; keep one"),
        ("frames: {stride: 1, stride: 5}\n", r"'stride' stands twice, on lines 1 and 1"),
        ("seed: 1\nframes:\n\tstride: 2\n", r"settings.yaml: a tab, where YAML has spaces alone \(line 3\)"),
        ("seed: 1\nframes: [1, 2\nfast: true\n", r"expected ',' or '\]', but got .* \(line 3\)"),
    ],
)
def test_what_is_wrong_with_a_text_is_named_by_its_lines(tmp_path, text, told):
    path = tmp_path / "settings.yaml"
    path.write_text(text)
    with pytest.raises(HaustraError, match=told):
        load_config(path)


def test_merged_sections_and_names_of_two_kinds_are_no_repetition():
    text = "base: &b {a: 1}\nmid: &m {<<: *b, a: 2}\ntop: {<<: *m}\nmixed: {1: x, '1': y}\nagain: *m\n"
    assert load_unique(text) == yaml.safe_load(text)


@pytest.mark.parametrize("config", [{"seed": 1}, "settings.yaml"])
def test_reconstruct_names_what_settings_must_be(tmp_path, config):
    with pytest.raises(HaustraError, match=rf"must be a haustra\.Config, .*, not a {type(config).__name__}"):
        reconstruct(tmp_path / "film.mp4", tmp_path / "run", config=config)
    assert not (tmp_path / "run").exists()


def test_a_setting_of_another_type_is_the_error_that_the_documentation_names():
    with pytest.raises(ValueError, match="seed") as caught:
        Config(seed="x")
    assert isinstance(caught.value, pydantic.ValidationError)
