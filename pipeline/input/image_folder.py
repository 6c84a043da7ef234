"""Pictures of a folder: which files are frames, in which order, and 8-bit pixels out of any depth of bits."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import HaustraError
from haustra.core.natural_order import in_natural_order
from haustra.core.text import check_name, counted, read_json

TIFF = {".tif", ".tiff"}
JPEG = {".jpg", ".jpeg", ".jpe", ".jfif"}
IMAGE_SUFFIXES = JPEG | TIFF | {".png", ".bmp", ".dib", ".ppm", ".pgm", ".pnm", ".webp", ".jp2"}
FILM_SUFFIXES = {".mp4", ".avi", ".mkv", ".mov", ".mpg", ".ts", ".wmv", ".webm", ".m4v"}
JPEG_START, JPEG_SCAN, JPEG_END = b"\xff\xd8", b"\xff\xda", b"\xff\xd9"
CLOCK = (
    r"(?<!\d)[0-2]\d[-_.:h][0-5]\d[-_.:m][0-5]\d(?!\d)|(?<!\d)(19|20)\d{6}\D?[0-2]\d[0-5]\d[0-5]\d"  # hours to seconds
)
# A camera's number behind its name, cam1_000; or its name between the frame's number and its own, 000_cam1. Seconds and
# minutes before the frame's number have no name.
CAMERA, CAMERA_LAST = r"[A-Za-z]\d+[^A-Za-z\d]*$", r"\d[^A-Za-z\d]*[A-Za-z]{2,}[^A-Za-z\d]*$"
MOST_CAMERAS = 4
MIN_GROUP = 3  # a single mask or thumbnail beside the frames is no kind of its own
FOLDER_FPS = 30.0  # of an image folder whose camera.json, if any, gives no fps; times are then nominal
MOST_FPS = 100_000.0
DEPTHS = (8, 10, 12, 14, 16)  # bits that cameras store in 16
MOST_SHOWN = 3  # groups of pictures that a sentence names
PROBED = 40  # pictures from which the bits of deep ones are found, each with the one after it


def read_picture(path: Path) -> NDArray | None:
    """(H,W,3) uint8 or uint16 RGB; None if it is no readable picture, or a JPEG that is cut off."""
    how = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH
    if path.suffix.lower() in JPEG and path.is_file():
        data = path.read_bytes()
        image = None if not data or _is_cut_off(data) else cv2.imdecode(np.frombuffer(data, np.uint8), how)
    else:
        image = cv2.imread(str(path), how)
    if image is None or image.dtype not in (np.uint8, np.uint16):
        return None
    return np.ascontiguousarray(image[..., ::-1])


def refuse_stack(path: Path) -> None:
    """HaustraError for a TIFF file that holds several pictures, of which readers give the first."""
    if path.suffix.lower() in TIFF and path.is_file() and (pages := cv2.imcount(str(path))) > 1:
        raise HaustraError(
            f"{path} is a stack of {pages} pictures in one TIFF file: save it as a folder of single pictures (ImageJ: "
            "Save As, Image Sequence), or as a film"
        )


def _is_cut_off(data: bytes) -> bool:
    """Of a JPEG: whether no end follows its last scan. OpenCV fills what is missing with grey and says nothing."""
    return data.startswith(JPEG_START) and data.rfind(JPEG_END) < data.rfind(JPEG_SCAN)


def bits_of(images: list[Path]) -> int:
    """Bits that the values of a folder's pictures need, 8 to 16, by the brightest of some spread over it."""
    step = max(1, len(images) // PROBED)
    probed = [path for number, path in enumerate(images) if number % step < 2]  # lamps may alternate
    brightest = max((int(picture.max()) for picture in map(read_picture, probed) if picture is not None), default=0)
    return next(bits for bits in DEPTHS if brightest < 2**bits)


def in_8_bits(picture: NDArray, bits: int) -> NDArray[np.uint8]:
    """A picture of so many bits, its brightest value near 255."""
    if picture.dtype == np.uint8:
        return picture
    return np.minimum(picture >> (bits - 8), 255).astype(np.uint8)


def images_of(folder: Path) -> tuple[list[Path], str]:
    """The frames of an image folder, or of the `rgb/` of an RGB-D folder, in natural order; and what was left out.

    Data sets mix colour frames with depth, normals and masks of the same size (SimCol3D, C3VD). Names are grouped by
    what is left without their numbers; of several groups the one that says colour is taken, and none is guessed.
    """
    inner = next((one for one in (folder / "rgb", folder) if one.is_dir() and any(_pictures(one))), folder)
    groups: dict[str, list[Path]] = {}
    images = list(_pictures(inner))
    count, twice = len(images), len({path.stem for path in images}) < len(images)  # each frame in two formats
    for path in images:
        check_name(path)
        kind = re.sub(r"\d+", "#", path.stem).lower() + (path.suffix.lower() if twice else "")
        groups.setdefault(kind, []).append(path)
    if len(groups) > MIN_GROUP and max(map(len, groups.values())) == 1:
        films = _films(folder)
        instead = f", or give the film {films[0]} that lies beside them" if films else ""
        raise HaustraError(
            f"the names of the images in {inner} have no number that says their order; number them{instead}"
        )
    if max(map(len, groups.values()), default=0) >= MIN_GROUP:
        groups = {name: paths for name, paths in groups.items() if len(paths) >= MIN_GROUP}
    named = {name for name in groups if any(word in name for word in ("color", "colour", "rgb", "framebuffer"))}
    if len(groups) > 1 and len(named) != 1:
        raise HaustraError(f"{inner} holds several kinds of images ({', '.join(sorted(groups))}); give one in a folder")
    chosen = named.pop() if len(groups) > 1 else next(iter(groups), "")
    left_out = count - len(groups.get(chosen, []))
    were = "was" if left_out == 1 else "were"
    notes = [f"{counted(left_out, 'image')} of other kinds in {inner.name} {were} left out"] if left_out else []
    if count and inner == folder and (films := _films(folder)):
        notes.append(f"{inner.name} also holds the film {films[0]}, which was passed over for its {count} images")
    ordered = in_natural_order(groups.get(chosen, []))
    if restart := _restart([path.stem for path in ordered]):
        notes.append(restart)
    return ordered, "; ".join(notes)


def _restart(names: list[str]) -> str:
    """A sentence where the last number of ordered names starts again each time that an earlier one changes, as those of
    two cameras in one folder do; empty where not, and for decimals and times of the day."""
    groups: dict[str, list[int]] = {}
    for name in names:
        before, number = re.findall(r"^(.*?)(\d+)\D*$", name)[0] if re.search(r"\d", name) else (name, "0")
        groups.setdefault(before, []).append(int(number))
    numbers = list(groups.values())
    if len(groups) < 2 or min(map(len, numbers)) < 2 or re.search(r"\d\.$", next(iter(groups))):
        return ""
    if any(later[0] > earlier[-1] for earlier, later in pairwise(numbers)) or re.search(CLOCK, names[0]):
        return ""
    numbered, in_turn = (all(re.search(kind, before) for before in groups) for kind in (CAMERA, CAMERA_LAST))
    if not (numbered and len(groups) <= MOST_CAMERAS) and not (in_turn and len(set(map(tuple, numbers))) == 1):
        return ""
    shown = [f"{before}... ({len(group)} pictures)" for before, group in groups.items()][:MOST_SHOWN]
    more = f" and {counted(len(groups) - len(shown), 'more group')}" if len(groups) > len(shown) else ""
    return (
        f"the last number of the pictures' names starts again: {', '.join(shown)}{more} were read one after the other, "
        "as one film; pictures of two cameras need a folder each"
    )


def rows_by_number(pictures: Sequence[str], others: Sequence[str]) -> dict[int, int] | None:
    """Which picture, by its row, a number in the name of another program's file means, where both are numbered alike:
    each number of `others` is the last one in the name of one picture. None where they are not."""
    own, theirs = ([re.findall(r"\d+", Path(name).stem)[-1:] for name in names] for names in (pictures, others))
    rows = {int(number[0]): row for row, number in enumerate(own) if number}
    if len(rows) < len(pictures) or not all(number and int(number[0]) in rows for number in theirs):
        return None
    return rows


def _pictures(folder: Path) -> Iterator[Path]:
    """By their names; macOS leaves a "._" companion, which is none, beside every file that it copies."""
    return (p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith("."))


def _films(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir() if p.suffix.lower() in FILM_SUFFIXES and not p.name.startswith("."))


def what_else_is_in(folder: Path) -> str:
    """A sentence's end about a folder without pictures: which to give instead, or what its files are."""
    inside = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    films = _films(folder)
    for path in inside:
        if path.is_dir() and any(one.suffix.lower() in IMAGE_SUFFIXES for one in path.iterdir()):
            return f"there are some in {path.name} inside it: give that folder"
    if films:
        several = f", or all of them, as {folder}/*{Path(films[0]).suffix}, to haustra batch" if len(films) > 1 else ""
        return f"it holds the film {films[0]}: give the file{several}"
    kinds = Counter(path.suffix.lower() for path in inside if path.is_file()).most_common(1)
    most = "" if not kinds else f"are {kinds[0][0]}" if kinds[0][0] else "have no suffix"
    found = f"most of its files {most}" if kinds else "it is empty"
    return f"{found}; those that are: {' '.join(sorted(IMAGE_SUFFIXES))}"


def folder_fps(folder: Path) -> float:
    """Frames a second of an RGB-D folder; `FOLDER_FPS` where it does not say. HaustraError where it says nonsense."""
    try:
        said = read_json(folder / "camera.json").get("fps")
        fps = FOLDER_FPS if said is None else float(said)
    except HaustraError:
        return FOLDER_FPS
    except (ValueError, TypeError, OverflowError):
        fps = 0.0
    if not 0 < fps < MOST_FPS or isinstance(said, bool):
        raise HaustraError(f"fps in {folder / 'camera.json'} is {said!r}, no number of frames a second")
    return fps
