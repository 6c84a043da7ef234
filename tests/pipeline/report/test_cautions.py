"""The one list of reasons not to trust a run."""

from types import SimpleNamespace

from pipeline.report.cautions import reasons_for_doubt

GUESSED = "camera: focal length guessed as 99 px for working frames 320 px wide"
FREE = f"{GUESSED}, and kept; no trusted map determines it: shapes may be stretched"
FIXED = f"{GUESSED}, 98 px after adjustment (sigma 0.2 px for 1 px of noise)"


def surface(doubt="", clock=""):
    return SimpleNamespace(scale=SimpleNamespace(doubt=doubt, clock_doubt=clock))


def submap(trust=FIXED, contradicted=()):
    return {"camera": {"trust": trust}, "contradicted_keyframes": list(contradicted)}


def test_a_sound_run_has_none():
    assert reasons_for_doubt([], [surface()], [submap()]) == []


def test_a_lens_that_the_film_does_not_fix_comes_first_and_once():
    said = reasons_for_doubt(["the light contradicts submap 0"], [surface()] * 2, [submap(FREE), submap(FREE)])
    assert said == [FREE, "the light contradicts submap 0"]


def test_scale_and_depth_come_last_with_the_number_of_the_submap():
    said = reasons_for_doubt(["moved"], [surface("no mm"), surface("no mm")], [submap(), submap(contradicted=[4, 9])])
    assert said[:2] == ["moved", "no mm"]
    assert said[2].startswith("submap 1: keyframes 4, 9: their neighbours contradict")
    assert len(said) == 3


def test_unit_and_clock_of_a_sensor_are_both_said_once():
    surfaces = [
        surface("unit: 3.2"),
        surface("unit: 0.4", "2 late"),
        surface("by file", "3 late"),
        surface(clock="early"),
    ]
    assert reasons_for_doubt([], surfaces, [submap()] * 4) == ["unit: 3.2", "by file", "2 late", "early"]
