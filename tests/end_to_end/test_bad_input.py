"""Bad input: one clear sentence on standard error, exit code 1, no traceback."""

import json
import os
import sys

import cv2
import numpy as np
import pytest
import yaml

from pipeline.cli import main as cli
from pipeline.frontend import structure_stage
from tests.helpers.videos import textured_frames, write_video


@pytest.fixture
def run(monkeypatch, capsys, tmp_path):
    """Call `reconstruct` with arguments; returns (exit code, standard error)."""

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["reconstruct", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            cli.reconstruct_main()
        return stop.value.code, capsys.readouterr().err

    monkeypatch.chdir(tmp_path)
    return call


def assert_one_sentence(outcome, words):
    code, error = outcome
    assert code == 1
    lines = [line for line in error.splitlines() if line.startswith("error:")]
    assert len(lines) == 1
    assert error.strip().splitlines()[-1] == lines[0]
    assert words in lines[0]
    assert "Traceback" not in error
    return lines[0]


def test_missing_file(run):
    assert_one_sentence(run("nowhere.mp4"), "there is no file or folder nowhere.mp4")


def test_zero_byte_file(run, tmp_path):
    (tmp_path / "a.mp4").touch()
    assert_one_sentence(run("a.mp4"), "is empty")


def test_text_file_named_mp4(run, tmp_path):
    (tmp_path / "a.mp4").write_text("this is not a video\n" * 100)
    assert_one_sentence(run("a.mp4"), "not a video")


def test_video_without_its_index(run, tmp_path):
    """An MP4 recorder writes the index last; a file cut off before it cannot be read at all."""
    import av

    with av.open(str(tmp_path / "a.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width = stream.height = 160
        for frame in textured_frames(30):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())
    data = (tmp_path / "a.mp4").read_bytes()
    (tmp_path / "a.mp4").write_bytes(data[: len(data) // 2])
    assert_one_sentence(run("a.mp4"), "not a video that FFmpeg can read (or its index is cut off)")


def test_sound_without_pictures(run, tmp_path):
    import wave

    with wave.open(str(tmp_path / "a.wav"), "wb") as sound:
        sound.setnchannels(1)
        sound.setsampwidth(2)
        sound.setframerate(8000)
        sound.writeframes(b"\0" * 8000)
    assert_one_sentence(run("a.wav"), "no video stream")


def test_one_frame_video(run, tmp_path):
    write_video(tmp_path / "a.mp4", textured_frames(1))
    assert_one_sentence(run("a.mp4"), "the input has 1 frame to look at; at least 3 are needed")


def test_all_black_video(run, tmp_path):
    write_video(tmp_path / "a.mp4", [np.zeros((160, 160, 3), np.uint8)] * 10)
    assert_one_sentence(run("a.mp4"), "the video is black")


def test_static_video(run, tmp_path):
    write_video(tmp_path / "a.mp4", textured_frames(1) * 10)
    assert_one_sentence(run("a.mp4"), "9 duplicate); give a part where the camera moves")


def test_video_without_features(run, tmp_path):
    ramp = np.linspace(60, 160, 160)
    frames = [np.repeat(np.tile(ramp + 3 * i, (160, 1))[..., None], 3, 2).astype(np.uint8) for i in range(10)]
    write_video(tmp_path / "a.mp4", frames)
    assert_one_sentence(run("a.mp4"), "no texture")


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 10))])
def test_a_film_that_was_refused_does_not_block_the_corrected_command(run, tmp_path, seed):
    """Refused for want of frames, or of structure once they were read: the next command needs no --overwrite."""
    count = seed % 2 * 4 + 2
    write_video(tmp_path / "a.mp4", [textured_frames(1, seed=10 * seed + i)[0] for i in range(count)])
    told = "the input has 2 frames to look at" if count == 2 else "no two frames could be related"
    assert_one_sentence(run("a.mp4", "-o", "out", "-q"), told)
    assert_one_sentence(run("a.mp4", "-o", "out", "-q", "--seed", str(seed)), told)
    assert_one_sentence(run("a.mp4", "-o", "out", "-q", "--seed", str(seed), "--resume"), told)


def test_unrelated_frames(run, tmp_path):
    """Texture in plenty, but no two frames show the same thing: structure fails, in one sentence."""
    write_video(tmp_path / "a.mp4", [textured_frames(1, seed=i)[0] for i in range(6)])
    told = assert_one_sentence(run("a.mp4", "-q", "--front-end", "odometry"), "no two frames could be related")
    assert "6 frames tried by odometry" in told
    assert "give a longer part, or one where the camera moves more (--start, --end), or try --front-end sfm" in told


def test_a_film_of_few_pixels_is_not_blamed_for_its_motion(run, tmp_path):
    write_video(tmp_path / "a.mp4", [frame[:32, :32] for frame in textured_frames(20)])
    told = assert_one_sentence(run("a.mp4", "-q", "--front-end", "odometry"), "no two frames could be related")
    assert "the pictures show 32x32 pixels, which hold few features: give larger ones" in told


def test_a_picture_of_another_size_in_a_folder(run, tmp_path):
    (tmp_path / "pictures").mkdir()
    for number, frame in enumerate(textured_frames(6)):
        size = (80, 60) if number == 4 else (160, 160)
        cv2.imwrite(str(tmp_path / "pictures" / f"{number}.png"), cv2.resize(frame, size))
    told = assert_one_sentence(
        run("pictures", "-q"), "4.png has 80x60 px, but the images before it in pictures have 160x160"
    )
    assert "images of one size" in told


def test_camera_file_for_another_resolution(run, tmp_path):
    write_video(tmp_path / "a.mp4", textured_frames(6))
    camera = {"model": "PINHOLE", "width": 320, "height": 240, "params": [160, 160, 160, 120]}
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    assert_one_sentence(run("a.mp4", "--camera", "camera.json"), "is for 320x240 pixels, but the frames have 160x160")


def test_poses_that_are_none_or_of_another_film(run, tmp_path):
    write_video(tmp_path / "a.mp4", textured_frames(6))
    assert_one_sentence(run("a.mp4", "--poses", "poses.txt"), "there is no file or folder poses.txt")
    (tmp_path / "poses.txt").write_text("".join(f"{100 + k} 0 0 {k} 0 0 0 1\n" for k in range(6)))
    assert_one_sentence(run("a.mp4", "--poses", "poses.txt"), "0 of 6 frames of the film and poses.txt are of one time")


def test_unknown_preset(run, tmp_path):
    write_video(tmp_path / "a.mp4", textured_frames(2))
    assert_one_sentence(run("a.mp4", "--camera", "olympus"), "neither 'auto', a file, nor a preset")


def test_output_is_a_file(run, tmp_path):
    write_video(tmp_path / "a.mp4", textured_frames(2))
    (tmp_path / "out").write_text("precious")
    assert_one_sentence(run("a.mp4", "-o", "out"), "is a file; give a folder")
    assert (tmp_path / "out").read_text() == "precious"


def test_output_holds_other_things(run, tmp_path):
    write_video(tmp_path / "a.mp4", textured_frames(2))
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("precious")
    assert_one_sentence(run("a.mp4", "-o", "out", "--overwrite"), "is not empty and holds no run")
    assert (tmp_path / "out" / "thesis.tex").read_text() == "precious"


def test_output_holds_a_run(run, tmp_path):
    write_video(tmp_path / "a.mp4", textured_frames(1))
    assert run("a.mp4", "-o", "out")[0] == 1
    assert (tmp_path / "out" / "run.yaml").exists()
    # It finished nothing, so the corrected command need not be told to overwrite it.
    assert_one_sentence(run("a.mp4", "-o", "out"), "the input has 1 frame to look at")
    record = yaml.safe_load((tmp_path / "out" / "run.yaml").read_text())
    assert record.pop("refused").startswith("the input has 1 frame to look at")
    (tmp_path / "out" / "run.yaml").write_text(yaml.safe_dump(record | {"stages": {"frames": {}}}))
    assert_one_sentence(run("a.mp4", "-o", "out"), "already holds a run; add --resume")
    assert_one_sentence(run("a.mp4", "-o", "out", "--overwrite"), "the input has 1 frame to look at")


def test_resume_of_another_video(run, tmp_path):
    write_video(tmp_path / "a.mp4", textured_frames(1))
    write_video(tmp_path / "b.mp4", textured_frames(1, seed=1))
    run("a.mp4", "-o", "out")
    assert_one_sentence(run("b.mp4", "-o", "out", "--resume"), "is a run of another video")


def test_resume_with_other_settings(run, tmp_path):
    write_video(tmp_path / "a.mp4", textured_frames(1))
    run("a.mp4", "-o", "out")
    assert_one_sentence(run("a.mp4", "-o", "out", "--resume", "--seed", "4"), "other settings (seed: 0, now 4)")


def test_resume_of_nothing(run, tmp_path):
    write_video(tmp_path / "a.mp4", textured_frames(1))
    assert_one_sentence(run("a.mp4", "-o", "out", "--resume"), "is not a run folder")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("frames: {stride: 0}", "frames.stride"),
        ("colour: red", "colour"),
        ("[1, 2]", "not a mapping"),
        ("a: [", "cannot read"),
    ],
)
def test_wrong_settings_are_named(run, tmp_path, text, words):
    write_video(tmp_path / "a.mp4", textured_frames(2))
    (tmp_path / "c.yaml").write_text(text)
    assert_one_sentence(run("a.mp4", "--config", "c.yaml"), words)


def test_no_input_and_both_inputs(run):
    assert_one_sentence(run(), "give one video or folder, or --demo")
    assert_one_sentence(run("a.mp4", "--demo"), "give one video or folder, or --demo")


def test_unknown_model(run, tmp_path):
    write_video(tmp_path / "a.mp4", textured_frames(2))
    assert_one_sentence(run("a.mp4", "--model", "gpt"), "no model 'gpt'")


def test_more_iterations_than_the_model_was_trained_for(run, tmp_path):
    write_video(tmp_path / "a.mp4", textured_frames(2))
    for name in ("iterations", "looks"):  # the second is of earlier releases
        (tmp_path / "c.yaml").write_text(f"depth: {{{name}: 9}}")
        said = "trained for 3 iterations at most, and 9 are asked for"
        assert_one_sentence(run("a.mp4", "--config", "c.yaml"), said)


def test_a_pickle_is_not_a_model(run, tmp_path):
    write_video(tmp_path / "a.mp4", textured_frames(2))
    (tmp_path / "m.safetensors").write_bytes(b"\x80\x04K\x01.")
    assert_one_sentence(run("a.mp4", "--model", "m.safetensors"), "not a readable safetensors file")


@pytest.mark.parametrize("number", cli.FILE_SYSTEM_SAYS_NO)
@pytest.mark.parametrize("nested", [False, True])
def test_a_folder_that_cannot_be_copied_says_why(tmp_path, monkeypatch, capsys, number, nested):
    """`shutil.copytree` would gather such errors into one without a number."""
    source = tmp_path / "model" / "0" if nested else tmp_path / "model"
    source.mkdir(parents=True)
    (source / "images.bin").write_bytes(b"x")

    def refuse(one, two):
        raise OSError(number, os.strerror(number), str(two))

    monkeypatch.setattr(structure_stage.shutil, "copyfile", refuse)
    assert cli.run_cleanly(lambda: structure_stage._copy_folder(tmp_path / "model", tmp_path / "out")) == 1
    assert_one_sentence((1, capsys.readouterr().err), os.strerror(number))


def test_full_disk_keeps_what_is_done(run, tmp_path, monkeypatch):
    """The write of the frame list fails as on a full disk: one sentence, and the run folder stays."""
    import errno

    from pipeline.input import frames

    def no_space(path, value):
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    write_video(tmp_path / "a.mp4", textured_frames(6))
    monkeypatch.setattr(frames, "write_json", no_space)
    assert_one_sentence(run("a.mp4", "-o", "out"), "No space left on device")
    assert len(list((tmp_path / "out" / "images").glob("*.jpg"))) == 6
