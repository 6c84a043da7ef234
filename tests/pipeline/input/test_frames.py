"""Decoding, content area, highlights and the judgement of frames."""

import json
from fractions import Fraction

import cv2
import numpy as np
import pytest

from haustra.core.camera import Camera, read_camera
from haustra.core.errors import HaustraError
from haustra.core.progress import SilentProgress
from pipeline.config import Config
from pipeline.input.content_area import ContentArea, find_content, has_cut_corners, highlight_mask
from pipeline.input.frame_quality import FrameJudge
from pipeline.input.frames import read_frames, write_lens
from pipeline.input.video import Source
from pipeline.run_folder.creating import create_workspace
from pipeline.run_folder.workspace import Workspace
from tests.helpers.real_data import shared
from tests.helpers.videos import textured_frames, write_video


def on_black(frames, shape, top_left, mask=None):
    y, x = top_left
    canvases = []
    for frame in frames:
        canvas = np.zeros((*shape, 3), np.uint8)
        height, width = frame.shape[:2]
        canvas[y : y + height, x : x + width] = frame if mask is None else np.where(mask[..., None], frame, 0)
        canvases.append(canvas)
    return canvases


def test_the_lens_of_whole_pictures_is_that_of_working_frames(tmp_path):
    """The content is cut out at (20, 10) of a picture twice as large; frames that no stage read have no such lens."""
    workspace, working = Workspace(tmp_path), Camera("RADIAL", 60, 45, (50.0, 29.0, 23.0, -0.1, 0.01), False)
    write_lens(working, "guessed", workspace)
    assert not workspace.lens.exists()
    workspace.record["stages"]["frames"] = {"content_box": [20, 10, 120, 90], "source_size": [160, 120]}
    write_lens(working, "guessed", workspace)
    assert read_camera(workspace.lens) == Camera("RADIAL", 160, 120, (100.0, 78.0, 56.0, -0.1, 0.01), False)
    assert json.loads(workspace.lens.read_text())["origin"] == "guessed"


def disc(size):
    y, x = np.mgrid[:size, :size] - (size - 1) / 2
    return x * x + y * y < (0.49 * size) ** 2


def test_video_gives_every_frame_with_its_time(tmp_path):
    frames = textured_frames(12)
    read = list(Source(write_video(tmp_path / "a.mp4", frames, fps=25)))
    assert [f.index for f in read] == list(range(12))
    np.testing.assert_allclose([f.seconds for f in read], np.arange(12) / 25, atol=1e-6)
    assert np.abs(read[5].rgb.astype(int) - frames[5]).mean() < 6


def test_a_truncated_video_gives_what_decodes_and_says_so(tmp_path):
    path = write_video(tmp_path / "a.mp4", textured_frames(60), g="5")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    source = Source(path)
    count = len(list(source))
    assert 10 < count < 60
    assert any("ends early" in note or "decoding stopped" in note for note in source.notes)


def test_variable_frame_rate_keeps_the_time_stamps(tmp_path):
    import av

    path = tmp_path / "vfr.mkv"
    stamps = [0, 33, 66, 200, 233, 600]
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=1000)
        stream.width = stream.height = 160
        stream.pix_fmt = "yuv420p"
        for pts, rgb in zip(stamps, textured_frames(6), strict=True):
            frame = av.VideoFrame.from_ndarray(rgb, format="rgb24")
            frame.pts, frame.time_base = pts, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    np.testing.assert_allclose([f.seconds for f in Source(path)], np.array(stamps) / 1000, atol=2e-3)


def test_pixels_are_made_square(tmp_path):
    path = write_video(tmp_path / "sar.mp4", textured_frames(3), **{"x264-params": "sar=3/2"})
    source = Source(path)
    assert next(iter(source)).rgb.shape == (160, 240, 3)
    assert any("not square" in note for note in source.notes)


def test_damage_in_the_middle_costs_only_what_is_damaged(tmp_path):
    path = write_video(tmp_path / "a.mp4", textured_frames(60), g="10")
    data = bytearray(path.read_bytes())
    half = len(data) // 2
    data[half : half + 200] = bytes(200)
    path.write_bytes(bytes(data))
    frames = list(Source(path))
    assert len(frames) > 40
    assert frames[-1].seconds == pytest.approx(59 / 30, abs=0.01)


def test_an_unpadded_data_set_is_read_in_the_order_of_its_numbers(tmp_path):
    """C3VD's cecum_t1_a: unpadded numbers, and maps of other kinds in the same folder."""
    for i in (0, 1, 2, 10, 11):
        for kind in ("color", "normals", "occlusion"):
            cv2.imwrite(str(tmp_path / f"{i}_{kind}.png"), textured_frames(1)[0])
    source = Source(tmp_path)
    assert [p.name for p in source.images] == [f"{i}_color.png" for i in (0, 1, 2, 10, 11)]
    assert source.notes == [f"10 images of other kinds in {tmp_path.name} were left out"]


def test_kinds_of_images_are_not_guessed(tmp_path):
    for i in range(4):
        for kind in ("left", "right"):
            cv2.imwrite(str(tmp_path / f"{kind}{i}.png"), textured_frames(1)[0])
    with pytest.raises(HaustraError, match="several kinds of images"):
        Source(tmp_path)


def test_an_rgbd_folder_keeps_its_frame_rate(tmp_path):
    (tmp_path / "rgb").mkdir()
    for i, frame in enumerate(textured_frames(3)):
        cv2.imwrite(str(tmp_path / "rgb" / f"{i:05d}.png"), frame)
    (tmp_path / "camera.json").write_text('{"fps": 25}')
    np.testing.assert_allclose([f.seconds for f in Source(tmp_path)], [0, 0.04, 0.08])


def test_an_image_folder_is_read_in_name_order_without_depth_maps(tmp_path):
    for i, frame in enumerate(textured_frames(3)):
        cv2.imwrite(str(tmp_path / f"FrameBuffer_{i:04d}.png"), frame)
        cv2.imwrite(str(tmp_path / f"Depth_{i:04d}.png"), frame)
    assert [f.index for f in Source(tmp_path)] == [0, 1, 2]


def test_content_is_the_lit_disc_without_burned_in_text():
    canvases = on_black(textured_frames(8, 200), (300, 500), (50, 250), disc(200))
    for canvas in canvases:
        cv2.putText(canvas, "J. DOE 1970", (10, 40), cv2.FONT_HERSHEY_SIMPLEX, 0.8, (255, 255, 255), 2)
    area = find_content(canvases)
    truth = np.zeros((300, 500), bool)
    truth[50:250, 250:450] = disc(200)
    found = area.mask > 0
    assert not (found & ~truth).any()
    assert found.sum() > 0.8 * truth.sum()
    assert area.box[0] >= 250
    assert not found[:60, :200].any()


def test_content_is_the_whole_frame_when_there_is_no_border():
    assert (find_content(textured_frames(5)).mask == 255).all()


def test_a_title_card_does_not_light_the_border():
    canvases = on_black(textured_frames(16, 200), (300, 500), (50, 250), disc(200))
    canvases[3] = np.full_like(canvases[3], 200)
    assert find_content(canvases).box[0] >= 250


def test_black_has_no_content():
    with pytest.raises(HaustraError, match="black"):
        find_content([np.zeros((100, 100, 3), np.uint8)] * 3)


def test_highlights_are_masked_and_tissue_is_not():
    frame = textured_frames(1)[0].copy()
    frame[60:66, 80:86] = 255
    mask = highlight_mask(frame)
    assert mask[63, 83] == 255
    assert (mask > 0).mean() < 0.02


def test_the_sinus_disc_agrees_with_the_authors_mask():
    folder = shared("sinus")
    frames = [cv2.imread(str(p))[..., ::-1] for p in sorted(folder.glob("*.jpg"))[::5]]
    found = find_content(frames).mask > 0
    theirs = cv2.imread(str(folder / "undistorted_mask.png"), cv2.IMREAD_GRAYSCALE) > 128
    assert (found & theirs).sum() / (found | theirs).sum() > 0.9
    assert (found & ~theirs).mean() < 0.001


def judge_all(frames):
    judge = FrameJudge()
    content = np.full(frames[0].shape[:2], 255, np.uint8)
    return [judge.judge(frame, content) for frame in frames]


def test_each_kind_of_useless_frame_is_named():
    good = textured_frames(8)
    blurred = cv2.GaussianBlur(good[7], (0, 0), 2.5)
    red_out = np.full_like(good[0], (180, 30, 25))
    black, burnt = np.zeros_like(good[0]), np.full_like(good[0], 255)
    verdicts = judge_all([*good[:6], blurred, red_out, black, burnt, good[6], good[6]])
    assert verdicts == ["used"] * 6 + ["blurred", "no texture", "black", "overexposed", "used", "duplicate"]


def on_the_lens(frame, red):
    """The frame through red light that hides most of it, and drops on the lens, which are not red-out's own texture."""
    through = 0.85 * np.array(red) + 0.15 * cv2.GaussianBlur(frame, (0, 0), 3)
    through[::40, ::40] += 20
    return cv2.GaussianBlur(through.clip(0, 255).astype(np.uint8), (0, 0), 2)


def test_red_out_is_redder_than_the_film_and_has_little_texture():
    """By the film's own colour: a film that is so red all along has none, and red wall with texture is wall."""
    wall = [(0.8 * frame * [1.0, 0.6, 0.5]).astype(np.uint8) for frame in textured_frames(80)]
    covered = on_the_lens(wall[70], (230, 80, 40))
    redder = (wall[71] * [1.0, 0.6, 0.6]).astype(np.uint8)
    paler = on_the_lens(wall[72], (200, 120, 100))
    assert judge_all([*wall[:70], covered, redder]) == ["used"] * 70 + ["red-out", "used"]
    assert judge_all([*wall[:70], paler])[-1] != "red-out"
    assert "red-out" not in judge_all([on_the_lens(frame, (230, 80, 40)) for frame in wall] + wall[:10])


@pytest.mark.parametrize(("before", "lost"), [(30, 0), (40, 20), (100, 100), (400, 150)])
def test_a_film_that_turns_red_for_good_is_used_after_as_many_frames_again(before, lost):
    """It began outside the patient: grey, and with more texture than the wall."""
    grey = np.stack([frame.mean(axis=2) for frame in textured_frames(before)])
    room = [np.repeat(one[..., None], 3, axis=2).astype(np.uint8) for one in np.clip(1.2 * (grey - 100) + 100, 0, 235)]
    wall = [(0.8 * frame * [1.0, 0.4, 0.3]).astype(np.uint8) for frame in textured_frames(200)]
    verdicts = judge_all([*room, *wall])[before:]
    assert abs(verdicts.count("red-out") - lost) <= 2
    assert set(verdicts[160:]) == {"used"}


@pytest.mark.parametrize("noise", [0, 2, 5])
@pytest.mark.parametrize("contrast", [5, 0])
def test_texture_is_seen_through_a_codec_and_noise_is_none(tmp_path, contrast, noise):
    """Vessels some ten pixels wide and `contrast` grey levels strong, in light that falls off; or nothing but noise."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:240, :320]
    vessels = cv2.GaussianBlur(rng.normal(size=(240, 320 + 48)), (0, 0), 3)
    vessels *= contrast / vessels.std()
    light = 150 - 60 * np.hypot((x - 160) / 160, (y - 120) / 120)
    frames = []
    for shift in range(0, 48, 4):
        grey = light + vessels[:, shift : shift + 320] + noise * rng.normal(size=x.shape)
        frames.append(np.clip(np.stack([grey * 1.2, grey * 0.6, grey * 0.5], axis=2), 0, 255).astype(np.uint8))
    read = [frame.rgb for frame in Source(write_video(tmp_path / "a.mp4", frames, crf="30"))]
    verdicts = set(judge_all(read)[1:])  # the first is never a duplicate
    assert verdicts == {"used"} if contrast else verdicts <= {"no texture", "duplicate"}


@pytest.mark.parametrize("side", [96, 320])
@pytest.mark.parametrize("glints", [0, 60])
def test_light_that_falls_off_and_glints_are_no_texture(side, glints):
    """The lens on the wall, at a small and at the usual working size."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[: 3 * side // 4, :side]
    grey = 150 - 60 * np.hypot((x - side / 2) / (side / 2), (y - 3 * side / 8) / (3 * side / 8)) ** 2
    image = np.stack([grey * 1.2, grey * 0.6, grey * 0.5], axis=2).clip(0, 255).astype(np.uint8)
    for across, down in rng.uniform(0, (side, 3 * side // 4), (glints if side > 100 else glints // 10, 2)):
        cv2.circle(image, (int(across), int(down)), 2, (255, 255, 255), -1)
    assert judge_all([image]) == ["no texture"]


@pytest.mark.parametrize(
    ("cut", "said"),
    [("none", False), ("octagon", True), ("one corner under text", True), ("left", False), ("disc", False)],
)
def test_a_colonoscope_s_picture_is_known_by_its_corners(cut, said):
    y, x = np.mgrid[:240, :320]
    off = np.abs(x - 159.5) / 160 + np.abs(y - 119.5) / 120
    shown = {"none": off < 9, "octagon": off < 1.5, "one corner under text": (off < 1.5) | ((x < 60) & (y > 180))}
    shown |= {"left": (off < 1.5) | (x > 160), "disc": (x - 159.5) ** 2 + (y - 119.5) ** 2 < 119**2}
    left = int(np.flatnonzero(shown[cut].any(axis=0))[0])
    mask = np.where(shown[cut], 255, 0).astype(np.uint8)
    area = ContentArea(mask, (left, 0, 320 - 2 * left, 240), mask)
    assert has_cut_corners(area) == said


@pytest.mark.parametrize(
    "failing", ["images/000000.jpg", "images/000005.jpg", "images/000011.jpg", "masks/000005.jpg.png"]
)
def test_a_frame_that_cannot_be_written_ends_the_stage_with_one_sentence(tmp_path, monkeypatch, failing):
    """Frames are written while the next is read: of the first, of one in the middle and of the last one."""
    write = cv2.imwrite
    monkeypatch.setattr(cv2, "imwrite", lambda path, *rest: not path.endswith(failing) and write(path, *rest))
    film = write_video(tmp_path / "a.mp4", textured_frames(12), fps=25)
    with create_workspace(tmp_path / "run", film, Config(), False) as workspace:
        with pytest.raises(HaustraError, match=rf"cannot write .*{failing}; is the disk full"):
            read_frames(Source(film), "auto", Config().frames, workspace, SilentProgress())
        assert not workspace.is_done("frames")
