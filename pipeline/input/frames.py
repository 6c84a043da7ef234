"""Stage 1: a source to working frames on disk, each judged, with the camera that belongs to them."""

import itertools
import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera
from haustra.core.errors import HaustraError
from haustra.core.extrapolation import extrapolated
from haustra.core.progress import Progress, ProgressCallback
from haustra.core.text import counted
from haustra.core.threads import prefetched
from pipeline.config import FrameSettings
from pipeline.input.calibration import Calibration, calibrate
from pipeline.input.content_area import ContentArea, find_content, has_cut_corners, highlight_mask
from pipeline.input.frame_quality import FrameJudge
from pipeline.input.layout.digital_zoom import OTHER_ZOOM, DigitalZoom, LookedAt
from pipeline.input.layout.picture_layout import PictureLayout
from pipeline.input.video import RawFrame, Source
from pipeline.run_folder.stage import load_or_make
from pipeline.run_folder.workspace import Workspace, report_corruption, write_json

CONTENT_SAMPLES = 24  # frames looked at for the content area,
CONTENT_STRIDE = 25  # of which 25 apart are 20 s: long enough for the view to move over all of it
STAGE = "frames"
LENS_STAGE = "lens"  # after it, where the lens is guessed: `pipeline.frontend.lens_guess`
MIN_FRAMES = 3
SENSED_MM = 0.01  # mm of a step of depth that the source measured


@dataclass(frozen=True)
class Frames:
    """The working frames: those that are worth tracking, cropped to the content area and scaled, on disk."""

    index: NDArray[np.int64]  # (N,) numbers in the source, ascending
    seconds: NDArray[np.float64]  # (N,) from the source's first frame
    camera: Camera  # of the working frames, with the lens's distortion
    content: NDArray[np.uint8]  # (H,W) mask of the content area, nonzero inside
    verdicts: dict[str, int]  # number of the source's frames by verdict, such as used or blurred

    def at(self, rows: NDArray[np.int64] | slice) -> "Frames":
        """Some of the frames."""
        return replace(self, index=self.index[rows], seconds=self.seconds[rows])

    def seconds_of(self, index: int) -> float:
        return float(self.seconds[np.searchsorted(self.index, index)])

    def seconds_of_numbers(self, numbers: NDArray[np.int64]) -> NDArray[np.float64]:
        """(N,) times of frames by their numbers in the source, (N,): between and beyond the working frames by their
        mean interval."""
        interval = (self.seconds[-1] - self.seconds[0]) / max(int(self.index[-1] - self.index[0]), 1)
        return extrapolated(numbers, self.index, self.seconds, float(interval))


def read_frames(
    source: Source, camera: str, settings: FrameSettings, workspace: Workspace, progress: Progress
) -> Frames:
    """Decode, judge and store the working frames; camera: a choice as `--camera` takes it."""
    return load_or_make(
        workspace,
        STAGE,
        lambda: load_frames(workspace),
        lambda: _read(source, camera, settings, workspace, progress),
    )


def _read(source: Source, choice: str, settings: FrameSettings, workspace: Workspace, progress: Progress) -> None:
    for folder in (workspace.images, workspace.masks):
        folder.mkdir(exist_ok=True)
    source.check()
    area, size = _find_area(source, settings)
    known = source.camera
    calibration = (
        calibrate(choice, source.path, size, area.box, has_cut_corners(area))
        if known is None
        else Calibration(known, "left eye, rectified")
    )
    scale = working_scale(area.box[2:], settings.long_side)
    camera = calibration.camera.cropped_and_scaled(*area.box, scale)
    verdicts = _store_frames(source, settings, area, camera, workspace, progress)
    counts = Counter(verdict for _, _, verdict in verdicts)
    if counts["used"] < MIN_FRAMES:
        raise HaustraError(_too_few(counts, source.notes))
    if unused := Counter({verdict: count for verdict, count in counts.items() if verdict != "used"}):
        progress.log(f"{unused.total()} of {counts.total()} frames are left out: {_listed(unused)}")
    write_png(workspace.masks / "content.png", resized(area.mask, area, camera, cv2.INTER_NEAREST))
    write_json(workspace.frames, {"camera": camera.to_dict(), "frames": verdicts})
    workspace.finish(
        STAGE,
        camera_origin=calibration.origin,
        lens_is_guessed=calibration.guessed,
        notes=source.notes,
        content_box=list(area.box),
        source_size=list(size),
        depth_error_per_mm=source.depth_error_per_mm,
    )
    given = [] if calibration.guessed else [f"camera: {calibration.origin}"]  # of a guess, the stage after it speaks
    for note in (*given, *source.notes):
        progress.log(note)


def write_lens(camera: Camera, origin: str, workspace: Workspace) -> None:
    """`lens.json`: `camera`, of working frames, as that of the source's whole pictures; nothing without a source."""
    if not workspace.is_done(STAGE):
        return
    record = workspace.result(STAGE)
    (x0, y0, *box), (width, height) = record["content_box"], record["source_size"]
    scale = max(camera.width, camera.height) / max(box)  # the longer side's is exact
    write_json(workspace.lens, camera.of_whole(x0, y0, width, height, scale).to_dict() | {"origin": origin})


def working_scale(box: tuple[int, int], long_side: int) -> float:
    """Scale to about `long_side` at which both sides come out whole: rounding one would stretch the image against the
    camera, by half a pixel at the border. One source pixel is never made larger."""
    longer, shorter = max(box), min(box)
    if longer <= long_side:
        return 1.0
    sizes = np.arange(round(0.95 * long_side), long_side + 1)
    misfit = np.abs(shorter * sizes / longer - np.round(shorter * sizes / longer))
    return float(sizes[misfit <= misfit.min() + 0.02][-1] / longer)


def _find_area(source: Source, settings: FrameSettings) -> tuple[ContentArea, tuple[int, int]]:
    """Content area and frame size (width, height); a black opening is skipped, black all through is an error."""
    stride = CONTENT_STRIDE
    if 0 < source.announced < CONTENT_SAMPLES * CONTENT_STRIDE:
        stride = max(1, source.announced // CONTENT_SAMPLES)
    looked_at, passed = 0, list[float]()
    sampled = (frame.rgb for frame in itertools.islice(_in_range(source, settings, passed), 0, None, stride))
    while window := list(itertools.islice(sampled, CONTENT_SAMPLES)):
        if looked_at == 0 and len(window) < CONTENT_SAMPLES and stride > 1:  # little is asked for: look at more of it
            finer = max(1, len(window) * stride // CONTENT_SAMPLES)
            window = [frame.rgb for frame in itertools.islice(_in_range(source, settings), 0, None, finer)]
        looked_at += len(window)
        try:
            return find_content(window), (window[0].shape[1], window[0].shape[0])
        except HaustraError:
            continue
    if looked_at == 0 and (settings.start_s > 0 or settings.end_s is not None):
        end = "the end" if settings.end_s is None else f"{settings.end_s:g} s"
        over = bool(passed) and passed[-1] < settings.start_s
        last = f"; the film's last frame is at {passed[-1]:.2f} s" if over else ""
        raise HaustraError(f"no frame lies between {settings.start_s:g} s and {end}{last}")
    raise HaustraError("the video is black: no part of any frame is ever lit; give another part (--start), or film")


def _in_range(source: Source, settings: FrameSettings, passed: list[float] | None = None) -> Iterator[RawFrame]:
    """Frames from the start to the end that were asked for; passed: gets the seconds of all that were decoded."""
    for frame in source:
        if passed is not None:
            passed.append(frame.seconds)
        if settings.end_s is not None and frame.seconds >= settings.end_s:
            return
        if frame.seconds >= settings.start_s:
            yield frame


def _store_frames(
    source: Source, settings: FrameSettings, area: ContentArea, camera: Camera, workspace: Workspace, progress: Progress
) -> list[LookedAt]:
    """Write the image and mask of each used frame; returns (index, seconds, verdict) of all that were looked at."""
    content = resized(area.mask, area, camera, cv2.INTER_NEAREST)
    judge, layout, zoom = FrameJudge(), PictureLayout(area), DigitalZoom(content)
    verdicts: list[LookedAt] = []

    def used(advance: ProgressCallback) -> Iterator[_Used]:
        for frame in _in_range(source, settings):
            advance(frame.index + 1)
            if frame.index % settings.stride:
                continue
            rgb = resized(frame.rgb, area, camera, cv2.INTER_AREA)
            is_elsewhere = layout.is_elsewhere(frame.rgb, frame.seconds)
            verdicts.append((frame.index, frame.seconds, "other layout" if is_elsewhere else judge.judge(rgb, content)))
            if verdicts[-1][2] == "used":
                layout.remember(frame.seconds)
                zoom.remember(rgb, frame.index)
                yield _Used(frame.index, rgb, source.depth_mm())

    with progress.bar("reading frames", source.announced or None) as advance:
        for _ in prefetched(partial(_write_frame, workspace, content), used(advance), count=1):
            pass  # written while the next is judged
    source.notes += layout.notes
    verdicts = zoom.judged(verdicts, source.notes)
    for frame in (frame for frame, _, verdict in verdicts if verdict == OTHER_ZOOM):
        for path in (workspace.image_path(frame), workspace.mask_path(frame), workspace.sensor_path(frame)):
            path.unlink(missing_ok=True)
    return verdicts


@dataclass(frozen=True)
class _Used:
    """A frame that is worth tracking, at the working size; depth_mm where the source measures any."""

    index: int
    rgb: NDArray[np.uint8]
    depth_mm: NDArray[np.float64] | None


def _write_frame(workspace: Workspace, content: NDArray[np.uint8], frame: _Used) -> None:
    """A used frame's picture, the mask of what is neither border nor highlight, and what was sensed, if anything."""
    write_image(workspace.image_path(frame.index), frame.rgb)
    write_png(workspace.mask_path(frame.index), np.where(highlight_mask(frame.rgb) > 0, 0, content).astype(np.uint8))
    write_sensed(workspace.sensor_path(frame.index), frame.depth_mm)


def resized(image: NDArray[np.uint8], area: ContentArea, camera: Camera, interpolation: int) -> NDArray[np.uint8]:
    """Cut the content box out and bring it to the working size."""
    x, y, width, height = area.box
    cut = image[y : y + height, x : x + width]
    if cut.shape[:2] == (camera.height, camera.width):
        return np.ascontiguousarray(cut)
    return cv2.resize(cut, (camera.width, camera.height), interpolation=interpolation)


def write_image(path: Path, rgb: NDArray[np.uint8]) -> None:
    """JPEG at 97 without chroma subsampling: a third of PNG's size, and finer than the video's own compression."""
    options = [cv2.IMWRITE_JPEG_QUALITY, 97, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    _write(path, rgb[..., ::-1], options)


def write_png(path: Path, image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    """An image (H,W) without loss."""
    _write(path, image, [])


def _write(path: Path, image: NDArray[Any], options: list[int]) -> None:
    """cv2.imwrite, which says nothing where it cannot write."""
    if not cv2.imwrite(str(path), image, options):
        raise HaustraError(f"cannot write {path}; is the disk full?")


def write_sensed(path: Path, depth_mm: NDArray[np.float64] | None) -> None:
    """Depth (h,w) as 16-bit PNG in steps of `SENSED_MM`; nothing where there is none."""
    if depth_mm is not None:
        path.parent.mkdir(exist_ok=True)
        write_png(path, np.clip(np.rint(depth_mm / SENSED_MM), 0, 65535).astype(np.uint16))


def read_image(path: Path) -> NDArray[np.uint8]:
    """(H,W,3) uint8 RGB."""
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise HaustraError(f"{path} is missing or damaged; start the run anew with --overwrite")
    return np.ascontiguousarray(image[..., ::-1])


def _too_few(verdicts: Counter[str], notes: list[str]) -> str:
    if verdicts.total() < MIN_FRAMES:
        looked_at = counted(verdicts.total(), "frame")
        needed = f"the input has {looked_at} to look at; at least {MIN_FRAMES} are needed"
        return "; ".join([f"{needed}: give more of it (--start, --end, --stride), or another", *notes])
    tracked = f"only {verdicts['used']} of {verdicts.total()} frames can be tracked, at least {MIN_FRAMES} are needed"
    return "; ".join([f"{tracked} ({_listed(verdicts)})", "give a part where the camera moves and sees wall", *notes])


def _listed(verdicts: Counter[str]) -> str:
    return ", ".join(f"{count} {verdict}" for verdict, count in verdicts.items())


def guessed_by(workspace: Workspace) -> str | None:
    """How the lens of finished frames was guessed, one sentence; None where it was given."""
    record = workspace.result(STAGE)
    return record["camera_origin"] if record.get("lens_is_guessed") else None


def camera_origin(workspace: Workspace) -> str:
    """Where the camera of finished frames comes from, one sentence."""
    return str(_better_guess(workspace).get("origin", workspace.result(STAGE)["camera_origin"]))


def _better_guess(workspace: Workspace) -> dict[str, Any]:
    """`camera` and `origin` by the film itself, where it was asked and told."""
    return workspace.result(LENS_STAGE) if workspace.is_done(LENS_STAGE) else {}


def load_frames(workspace: Workspace) -> Frames:
    """The frames that an earlier call stored."""
    with report_corruption(workspace.frames):
        state = json.loads(workspace.frames.read_text())
        used = [(index, seconds) for index, seconds, verdict in state["frames"] if verdict == "used"]
        camera = Camera.from_dict(_better_guess(workspace).get("camera", state["camera"]))
    content = cv2.imread(str(workspace.masks / "content.png"), cv2.IMREAD_GRAYSCALE)
    if content is None:
        raise HaustraError(f"{workspace.masks} has lost its content mask; start the run anew with --overwrite")
    return Frames(
        np.array([index for index, _ in used]),
        np.array([seconds for _, seconds in used]),
        camera,
        content,
        dict(Counter(verdict for _, _, verdict in state["frames"])),
    )
