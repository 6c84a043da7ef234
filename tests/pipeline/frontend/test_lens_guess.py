"""An unknown lens: the film's beginning tells which of two guesses is nearer."""

from dataclasses import replace

import numpy as np
import pytest

from haustra.core.camera import Camera
from haustra.core.progress import SilentProgress
from pipeline import run
from pipeline.config import Config, FrameSettings
from pipeline.demo import VIDEO
from pipeline.frontend import lens_guess
from pipeline.frontend.lens_guess import GUESSES, guess_lens, scores_of_guesses
from pipeline.input.endomapper_scopes import LENSES, endomapper_camera
from pipeline.input.frames import camera_origin, guessed_by, load_frames
from pipeline.run_folder.workspace import open_workspace, write_json
from tests.helpers.tubes.textured_tube import SIZE, camera_at, render, stored

MEAN, NARROW = GUESSES
SETTINGS = Config().front_end_settings
SCOPE = endomapper_camera(min(LENSES)).cropped_and_scaled(0, 0, 1440, 1080, SIZE / 1440)
SCOPE = replace(SCOPE, width=SIZE, height=SIZE, params=(*SCOPE.params[:2], SIZE / 2, SIZE / 2, *SCOPE.params[4:]))
PINHOLE = Camera("PINHOLE", SIZE, SIZE, (90.0, 90.0, 96.0, 96.0))


def guessed(tmp_path, images):
    """A workspace whose frames are stored and whose lens nobody knows."""
    workspace, frames = stored(tmp_path, images)
    start = GUESSES[NARROW](SIZE, SIZE, (0, 0, SIZE, SIZE))
    verdicts = [[int(k), k / 30, "used"] for k in frames.index]
    write_json(workspace.frames, {"camera": start.to_dict(), "frames": verdicts})
    import cv2

    cv2.imwrite(str(workspace.masks / "content.png"), frames.content)
    workspace.finish("frames", camera_origin="guessed: by shape", lens_is_guessed=True)
    return workspace, replace(frames, camera=start)


@pytest.mark.parametrize(("lens", "right"), [(SCOPE, MEAN), pytest.param(PINHOLE, NARROW, marks=pytest.mark.slow)])
def test_the_guess_that_is_nearer_fits_better(tmp_path, lens, right):
    workspace, frames = guessed(tmp_path, [render(camera_at(k), lens) for k in range(40)])
    found = guess_lens(frames, SETTINGS, workspace, SilentProgress())
    scores = workspace.result("lens")["scores"]
    assert scores[right] > 1.05 * min(scores.values())
    assert found.camera == GUESSES[right](SIZE, SIZE, (0, 0, SIZE, SIZE))
    assert not found.camera.trusted
    assert camera_origin(workspace).startswith(f"guessed: {right}, with which the maps of the first frames keep")
    assert load_frames(workspace).camera == found.camera
    if lens is PINHOLE:  # two runs agree
        assert scores_of_guesses(frames, SETTINGS, workspace, SilentProgress()) == scores


@pytest.mark.parametrize(
    ("scores", "taken", "close"),
    [((100, 104), MEAN, True), ((100, 106), NARROW, False), ((104, 100), MEAN, True), ((0, 5), NARROW, False)],
)
def test_of_two_guesses_that_are_close_the_mean_is_taken_and_that_is_said(tmp_path, monkeypatch, scores, taken, close):
    workspace, frames = guessed(tmp_path, [np.zeros((SIZE, SIZE, 3), np.uint8)] * 3)
    monkeypatch.setattr(lens_guess, "scores_of_guesses", lambda *_: dict(zip(GUESSES, scores, strict=True)))
    found = guess_lens(frames, SETTINGS, workspace, SilentProgress())
    assert found.camera == GUESSES[taken](SIZE, SIZE, (0, 0, SIZE, SIZE))
    assert ("that is close" in camera_origin(workspace)) == close


def test_a_run_that_was_stopped_after_it_does_not_ask_again(tmp_path, monkeypatch):
    def stop(frames, *_):
        raise KeyboardInterrupt(frames.camera.params)

    monkeypatch.setattr(run, "solve_structure", stop)
    config = Config(camera="auto", front_end="odometry", frames=FrameSettings(end_s=0.9))
    with pytest.raises(KeyboardInterrupt) as first:
        run.reconstruct(VIDEO, tmp_path / "run", config)
    record = open_workspace(tmp_path / "run").result("lens")
    assert record["scores"][NARROW] > record["scores"][MEAN]  # the demo's is a pinhole of 90 degrees
    monkeypatch.delattr(lens_guess, "scores_of_guesses")
    with pytest.raises(KeyboardInterrupt) as again:
        run.reconstruct(VIDEO, tmp_path / "run", config, resume=True)
    assert again.value.args == first.value.args == (tuple(record["camera"]["params"]),)


def test_a_beginning_that_tells_nothing_leaves_the_guess_by_shape(tmp_path):
    workspace, frames = guessed(tmp_path, [np.full((SIZE, SIZE, 3), 90, np.uint8)] * 25)
    found = guess_lens(frames, SETTINGS, workspace, SilentProgress())
    assert workspace.result("lens") == {"scores": {MEAN: 0, NARROW: 0}}
    assert (found.camera, camera_origin(workspace)) == (frames.camera, "guessed: by shape")


def test_a_lens_that_was_given_is_no_guess(tmp_path):
    workspace, _ = stored(tmp_path, [np.zeros((SIZE, SIZE, 3), np.uint8)] * 3)
    workspace.finish("frames", camera_origin="file lens.json", lens_is_guessed=False)
    assert guessed_by(workspace) is None
    assert camera_origin(workspace) == "file lens.json"
