"""How a player shows a video's frames: turned and mirrored as the file says, and at times that go on."""

from fractions import Fraction
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.text import counted

if TYPE_CHECKING:
    from av import VideoFrame

UPRIGHT = np.eye(2)
RESTART = 8  # frames by which a time must fall back to be of another part of a joined film
LEAP_S = 3600.0  # no picture stands that long: the clock of another part
LEAST_STEP = 0.01  # of the frame interval, between frames whose stamps do not increase


class Clock:
    """Seconds from a film's first frame, increasing from frame to frame.

    Files that were cut or joined begin anywhere and start again in between: a part whose times run backwards, or leap
    an hour ahead, goes on where the part before it ended. rate: frames/s; has_times: False where only the rate is to be
    believed.
    """

    def __init__(self, rate: float, has_times: bool = True) -> None:
        self.step, self.has_times = 1 / rate, has_times
        self.notes: list[str] = []
        self._count, self._restarts, self._leaps = 0, 0, 0
        self._shift: float | None = None  # from the file's times to ours
        self.last = self.last_stamp = -self.step  # ours, and as the file has it

    def seconds(self, stamp: float | None) -> float:
        """Time of the next frame, whose time in the file is `stamp`; None where it has none."""
        self._count += 1
        if stamp is None or not self.has_times:
            self.last = max(self.last + self.step, (self._count - 1) * self.step)
            return self.last
        self.last_stamp = stamp
        if self._shift is None:
            self._shift = self.last + self.step - stamp
        backwards = stamp + self._shift < self.last - RESTART * self.step
        if backwards or stamp + self._shift > self.last + LEAP_S:
            self._shift = self.last + self.step - stamp
            self._restarts += backwards
            self._leaps += not backwards
            kinds = [("run backwards", self._restarts), ("leap over an hour ahead", self._leaps)]
            times = " and ".join(f"{what} {counted(count, 'time')}" for what, count in kinds if count)
            self.notes = [f"the film's time stamps {times}: each part was put behind the one before"]
        # A stamp that is repeated or a little early is of one frame alone: those after it are right.
        self.last = max(stamp + self._shift, self.last + LEAST_STEP * self.step)
        return self.last


class RgbConverter:
    """A film's frames as pixels (H,W,3) uint8. `VideoFrame.to_ndarray` sets a new converter up for every frame, which
    takes longer than the conversion."""

    def __init__(self) -> None:
        from av.video.reformatter import VideoReformatter

        self._reformatter = VideoReformatter()

    def __call__(self, frame: "VideoFrame") -> NDArray[np.uint8]:
        return np.asarray(self._reformatter.reformat(frame, format="rgb24").to_ndarray(), np.uint8)


def display_matrix(frame: "VideoFrame") -> NDArray[np.float64]:
    """(2,2) by which a player moves a frame's pixels: (x, y) of what is shown from (x, y) of what is stored.

    ISO 14496-12, 6.2.2: nine numbers a b u c d v x y w, of which x' = a x + c y and y' = b x + d y.
    Of a frame with data of a kind that PyAV has no name for, as EXIF of motion JPEG, the turn alone is known.
    """
    try:
        stored: Any = frame.side_data.get("DISPLAYMATRIX")
    except ValueError:
        angle = np.deg2rad(frame.rotation)  # against the clock
        return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    if stored is not None:
        a, b, _, c, d = np.frombuffer(bytes(stored), np.int32)[:5] / 65536
        return np.array([[a, c], [b, d]])
    return UPRIGHT


def upright(rgb: NDArray[np.uint8], matrix: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Pixels (H,W,3) as shown: turned by the nearest quarter of a circle, and mirrored where the matrix mirrors."""
    if abs(matrix[0, 0]) + abs(matrix[1, 1]) >= abs(matrix[0, 1]) + abs(matrix[1, 0]):
        across, down = matrix[0, 0], matrix[1, 1]
    else:
        rgb = rgb.swapaxes(0, 1)
        across, down = matrix[0, 1], matrix[1, 0]
    return rgb[:: -1 if down < 0 else 1, :: -1 if across < 0 else 1]


def upper_field(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The rows (H,W,3) of the upper field where they are, and the mean of two of them in place of each row of the lower
    field, which is of another time and would double all edges."""
    field = rgb[::2]
    between = cv2.addWeighted(field, 0.5, np.concatenate([field[1:], field[-1:]]), 0.5, 0)
    whole = np.empty_like(rgb)
    whole[::2], whole[1::2] = field, between[: len(rgb) // 2]
    return whole


def lower_field(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The same of the lower field: its rows (H,W,3) stay, and the others are the mean of two of them."""
    field = rgb[1::2]
    around = np.concatenate([field[:1], field, field[-1:]])
    between = cv2.addWeighted(around[:-1], 0.5, around[1:], 0.5, 0)
    whole = np.empty_like(rgb)
    whole[1::2], whole[::2] = field, between[: (len(rgb) + 1) // 2]
    return whole


def square_and_upright(rgb: NDArray[np.uint8], aspect: Fraction, matrix: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Pixels (H,W,3) as they are to be looked at. aspect: width over height of a pixel as stored."""
    if aspect != 1:
        rgb = cv2.resize(rgb, (round(rgb.shape[1] * float(aspect)), rgb.shape[0]), interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(upright(rgb, matrix))


def in_size(rgb: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8] | None:
    """A picture (H,W,3) in the size (width, height) of a film's first one; None where its shape is another."""
    height, width = rgb.shape[:2]
    if (width, height) == size:
        return rgb
    if abs(width * size[1] - height * size[0]) > max(width, height):
        return None
    return np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.uint8)
