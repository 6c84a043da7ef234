"""Folders of pictures: which files are frames, in which order, of how many bits, and what is said of the others."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from haustra.core.errors import HaustraError
from haustra.core.natural_order import in_natural_order
from pipeline.input.image_folder import images_of
from pipeline.input.video import Source


def write_pictures(folder: Path, names: list[str], suffix: str = ".png") -> Path:
    """Grey pictures of these names, as PNG whatever the suffix says."""
    folder.mkdir(exist_ok=True)
    data = cv2.imencode(".png", np.full((64, 64, 3), 90, np.uint8))[1].tobytes()
    for name in names:
        (folder / f"{name}{suffix}").write_bytes(data)
    return folder


@pytest.mark.parametrize("bits", [10, 12, 14, 16])
def test_deep_pictures_are_brought_to_8_bits_by_their_own_range(tmp_path: Path, bits: int) -> None:
    ramp = np.linspace(0, 2**bits - 1, 64).astype(np.uint16)
    for number in range(5):
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.broadcast_to(ramp[:, None, None], (64, 64, 3)).copy())
    source = Source(tmp_path)
    for frame in source:
        np.testing.assert_allclose(frame.rgb[:, 0, 0], 255 * ramp.astype(float) / (2**bits - 1), atol=1)
    assert any(f"{bits} bits" in note for note in source.notes)


def deep(folder: Path, brightest: list[int]) -> Source:
    """A folder of 16-bit pictures with these brightest values."""
    for number, value in enumerate(brightest):
        cv2.imwrite(str(folder / f"{number}.png"), np.full((64, 64, 3), value, np.uint16))
    return Source(folder)


@pytest.mark.parametrize("every", [2, 3, 5])
def test_the_bits_are_those_of_the_brightest_where_lamps_alternate(tmp_path: Path, every: int) -> None:
    source = deep(tmp_path, [800 if number % every == 0 else 4000 for number in range(40 * every)])
    assert [int(frame.rgb.max()) for frame in source][:2] == [50, 250]
    assert source.notes == ["the pictures hold values of 12 bits: they were brought to 8"]


def test_values_beyond_the_bits_that_were_found_are_told(tmp_path: Path) -> None:
    source = deep(tmp_path, [4000 if number == 113 else 800 for number in range(150)])
    list(source)
    assert any("more than 10 bits, which were cut" in note for note in source.notes)


def test_companions_of_macos_are_no_pictures(tmp_path: Path) -> None:
    for number in range(5):
        cv2.imwrite(str(tmp_path / f"frame_{number}.png"), np.full((64, 64, 3), 90, np.uint8))
        (tmp_path / f"._frame_{number}.png").write_bytes(b"\x00\x05\x16\x07")
    assert [image.name for image in Source(tmp_path).images] == [f"frame_{number}.png" for number in range(5)]


@pytest.mark.parametrize(
    ("names", "ordered"),
    [
        (["0.4", "0.05", "10.0", "0.35"], ["0.05", "0.35", "0.4", "10.0"]),
        (["1.10", "1.9", "1.1"], ["1.1", "1.9", "1.10"]),
        (["1.1000", "1.099", "1.1001", "1.999"], ["1.099", "1.999", "1.1000", "1.1001"]),
        (["f10", "f9", "f100"], ["f9", "f10", "f100"]),
        (["a2b10", "a2b9", "a10b1"], ["a2b9", "a2b10", "a10b1"]),
    ],
)
def test_numbers_are_ordered_by_value(names: list[str], ordered: list[str]) -> None:
    found = in_natural_order([Path(f"{name}.png") for name in names])
    assert [path.stem for path in found] == ordered


def test_capitals_are_no_other_order() -> None:
    names = ["IMG_1", "img_2", "IMG_3", "img_10", "IMG_11"]
    assert [path.stem for path in in_natural_order([Path(f"{name}.png") for name in sorted(names)])] == names


@pytest.mark.parametrize("suffix", [".jfif", ".jpe", ".JPG", ".TIFF", ".dib", ".pnm", ".webp", ".jp2", ".bmp", ".ppm"])
def test_what_a_picture_is_its_content_says_under_any_usual_suffix(tmp_path: Path, suffix: str) -> None:
    assert len(list(Source(write_pictures(tmp_path, list("12345"), suffix)))) == 5


def test_frames_in_two_formats_are_not_taken_twice(tmp_path: Path) -> None:
    write_pictures(write_pictures(tmp_path, list("12345")), list("12345"), ".jpg")
    with pytest.raises(HaustraError, match=r"several kinds of images \(#.jpg, #.png\); give one in a folder"):
        Source(tmp_path)


def test_frames_in_one_format_each_are_all_taken(tmp_path: Path) -> None:
    write_pictures(write_pictures(tmp_path, list("135")), list("246"), ".jpg")
    assert [image.stem for image in Source(tmp_path).images] == list("123456")


@pytest.mark.parametrize(
    ("names", "told"),
    [
        ([f"cam{c}_{n:03d}" for c in (1, 2) for n in range(4)], "cam1_... (4 pictures), cam2_... (4 pictures) were"),
        ([f"{n:03d}_cam{c}" for n in range(5) for c in (1, 2)], "000_cam... (2 pictures), 001_cam... (2 pictures), 0"),
        ([f"p1_clip{c}_{n}" for c in range(4) for n in range(2)], "and 1 more group were read one after the other"),
        ([f"vid_{m}m{s:02d}s" for m in range(2) for s in range(60)], ""),  # minutes and seconds
        ([f"img_{s:04d}_{n:02d}" for s in range(3) for n in range(25)], ""),  # a frame's number within its second
        ([f"part{c}_{10 * c + n}" for c in (1, 2) for n in range(4)], ""),  # the numbers go on
        ([f"{n / 10:.1f}s" for n in range(30)], ""),
        ([f"2024-01-05_10-{m:02d}-{s:02d}" for m in range(3) for s in range(60)], ""),
        ([f"20240105_1000{s:02d}_{n:03d}" for s in range(3) for n in range(0, 999, 40)], ""),
        ([f"t{n}_frame{39 - n}" for n in range(40)], ""),
        ([f"frame{n}" for n in range(12)], ""),
    ],
)
def test_two_cameras_in_one_folder_are_told(tmp_path: Path, names: list[str], told: str) -> None:
    source = Source(write_pictures(tmp_path, names))
    assert len(source.images) == len(names)
    assert (told in " ".join(source.notes)) if told else not source.notes


def test_names_without_an_order_are_told(tmp_path: Path) -> None:
    with pytest.raises(HaustraError, match="no number that says their order"):
        Source(write_pictures(tmp_path, ["caecum", "ileum", "rectum", "sigmoid", "polyp"]))


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda f: write_pictures(f, list("123"), ".heic"), "most of its files are .heic; those that are: .bmp"),
        (lambda f: write_pictures(f, list("123"), ""), "most of its files have no suffix; those that are: .bmp"),
        (lambda f: write_pictures(f / "sub", list("123")), "there are some in sub inside it: give that folder"),
        (lambda f: write_pictures(f, ["a"], ".mp4"), "it holds the film a.mp4: give the file"),
        (lambda f: write_pictures(f, ["a", "b"], ".AVI"), "give the file, or all of them, as"),
        (lambda f: write_pictures(f, [".hidden"]), "it is empty"),
    ],
)
def test_a_folder_without_pictures_says_what_to_give(tmp_path: Path, make, says: str) -> None:
    make(tmp_path)
    with pytest.raises(HaustraError, match="holds no images that are read") as told:
        Source(tmp_path)
    assert says in str(told.value)


def test_pictures_that_cannot_be_read_are_counted_in_one_sentence(tmp_path: Path) -> None:
    write_pictures(tmp_path, list("123456"))
    for name in "24":
        (tmp_path / f"{name}.png").write_bytes(b"damaged")
    source = Source(tmp_path)
    assert [frame.index for frame in source] == [0, 2, 4, 5]
    assert sum("2 of 6 images, 2.png the first, are no pictures" in note for note in source.notes) == len(source.notes)


@pytest.mark.parametrize("progressive", [0, 1])
@pytest.mark.parametrize("left", [0.3, 0.6, 0.95])
def test_a_jpeg_that_is_cut_off_is_left_out(tmp_path: Path, progressive: int, left: float) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (96, 96, 3), np.uint8)
    data = cv2.imencode(".jpg", noise, [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive])[1].tobytes()
    for number in range(5):
        whole = data if number != 2 else data[: int(left * len(data))]
        (tmp_path / f"{number}.jpg").write_bytes(whole + (b"trailer" if number == 4 else b""))
    source = Source(tmp_path)
    assert [frame.index for frame in source] == [0, 1, 3, 4]
    assert any("2.jpg the first" in note for note in source.notes)


def test_an_empty_folder_rgb_beside_the_pictures_hides_none(tmp_path: Path) -> None:
    write_pictures(tmp_path, list("12345"))
    (tmp_path / "rgb").mkdir()
    assert len(list(Source(tmp_path))) == 5


@pytest.mark.parametrize("dtype", [np.float32, np.int32])
def test_a_folder_of_pictures_of_other_numbers_is_one_sentence(tmp_path: Path, dtype: type) -> None:
    from PIL import Image

    for number in range(4):
        Image.fromarray(np.ones((64, 64), dtype)).save(tmp_path / f"{number}.tif")
    with pytest.raises(HaustraError, match=r"4 of 4 images, 0\.tif the first, are no pictures of 8 or 16 bits"):
        list(Source(tmp_path))


@pytest.mark.parametrize("fps", ["0", "-5", "NaN", "1e400", "1" + 400 * "0", "true", "[30]", '"fast"'])
def test_a_rate_that_is_none_is_one_sentence(tmp_path: Path, fps: str) -> None:
    write_pictures(tmp_path, list("12345"))
    (tmp_path / "camera.json").write_text(f'{{"fps": {fps}}}')
    with pytest.raises(HaustraError, match="no number of frames a second"):
        list(Source(tmp_path))


def test_pictures_whose_names_are_no_text_are_refused(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((8, 8, 3), np.uint8))
    (tmp_path / "a.png").rename(tmp_path / b"gr\xfcn_1.png".decode(errors="surrogateescape"))
    with pytest.raises(HaustraError, match="bytes that are no UTF-8"):
        images_of(tmp_path)
    with pytest.raises(HaustraError, match="bytes that are no UTF-8"):
        Source(tmp_path / b"gr\xfcn_1.png".decode(errors="surrogateescape"))
