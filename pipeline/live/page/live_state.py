"""What the page is told: written by the session, read by the server's threads."""

import threading
import time
from dataclasses import dataclass, field
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.se3 import Array
from pipeline.live.review_worker import Review
from pipeline.live.surface_part import KeyframeFate, SurfacePart

Phase = Literal["opening", "live", "ending", "finishing", "recorded", "done", "failed"]
View = Literal["waiting", "starting", "tracking", "lost", "no view", "no pictures"]

MOST_PARTS = 40  # of the surface that are kept; older ones are forgotten, and counted
MOST_PLACES = 600  # of the path that are shown
SHOWN_EVERY_S = 0.15  # between two pictures for the page
WATCHED_S = 3.0  # since the page last asked: nothing is painted for nobody
JPEG_QUALITY = 85
MOST_LATENCIES = 4000
SOON_S = 2.0  # after its picture a keyframe's surface should be there


@dataclass
class Counts:
    """came, skipped (not kept up with), looked_at (to find the picture in them), tracked (given to the tracker), posed:
    frames. unusable: black, blurred or without texture. shown (fused), contradicted (by those before), empty (too few
    points), unsure (no depth that is sure enough to be fused), dropped (not kept up with): keyframes. maps: begun;
    reviews: finished."""

    came: int = 0
    looked_at: int = 0
    skipped: int = 0
    unusable: int = 0
    tracked: int = 0
    posed: int = 0
    shown: int = 0
    contradicted: int = 0
    reviews: int = 0
    empty: int = 0
    unsure: int = 0
    dropped: int = 0
    maps: int = 0

    def count_keyframe(self, fate: KeyframeFate) -> None:
        """One more keyframe whose depth was completed."""
        self.shown += fate == "fused"
        self.contradicted += fate == "contradicted"
        self.unsure += fate == "unsure"


@dataclass
class LiveState:
    """Everything behind the page; use its methods, which lock."""

    name: str = ""
    phase: Phase = "opening"
    view: View = "waiting"
    advice: str = ""
    seconds: float = 0.0
    rate: float = 0.0  # frames given to the tracker each second
    counts: Counts = field(default_factory=Counts)
    fault: str = ""  # what has ended beside the tracking
    tracked_s: float = 0.0  # since the first frame was given to the tracker
    sentences: list[str] = field(default_factory=list)
    finishing: tuple[str, int, int | None] = ("", 0, None)
    stop_asked: threading.Event = field(default_factory=threading.Event)

    def __post_init__(self) -> None:
        self._lock = threading.Lock()
        self._parts: dict[int, SurfacePart] = {}
        self._forgotten, self._map_number = 0, -1
        self._review: Review | None = None
        self._path: list[tuple[int, list[float]]] = []  # frames and places
        self._pose: list[float] = []
        self._pictures: dict[str, bytes] = {}
        self._asked, self._painted = -WATCHED_S, 0.0
        self.latencies: list[float] = []  # s, from a keyframe's frame to its surface

    def wait_until_told(self, timeout: float) -> None:
        """Wait until the page has asked once more, if somebody looks at it."""
        asked, end = self._asked, time.monotonic() + timeout
        while self.is_watched and self._asked == asked and time.monotonic() < end:
            time.sleep(0.02)

    @property
    def is_watched(self) -> bool:
        return time.monotonic() - self._asked < WATCHED_S

    @property
    def parts(self) -> list[SurfacePart]:
        with self._lock:
            return list(self._parts.values())

    @property
    def summary(self) -> str:
        """The session in one sentence."""
        counts, latency = self.counts, _latency(self.latencies)
        after = "" if latency is None else f", {latency['median']:.1f} s after their picture in the median"
        return (
            f"live: {counts.posed} of {counts.came} frames posed, {counts.skipped} not kept up with; "
            f"{counts.shown} keyframes shown{after}, {counts.dropped} not kept up with"
        )

    def figures(self) -> dict[str, Any]:
        """For `live.json`: counts, and seconds from a keyframe's picture to its surface."""
        within = sum(seconds <= SOON_S for seconds in self.latencies) / max(len(self.latencies), 1)
        after = _latency(self.latencies)
        figures = None if after is None else after | {f"share_within_{SOON_S:g}_s": within}
        return {"counts": dict(vars(self.counts)), "tracked_s": self.tracked_s, "surface_after_s": figures}

    def say(self, sentence: str) -> None:
        with self._lock:
            if sentence not in self.sentences:
                self.sentences.append(sentence)

    def add_pose(self, frame: int, world_from_camera: Array, map_number: int) -> None:
        """Add world_from_camera (4,4) of the latest frame."""
        with self._lock:
            if map_number != self._map_number:
                self._path, self._map_number = [], map_number
            self._path.append((frame, [round(float(value), 5) for value in world_from_camera[:3, 3]]))
            if len(self._path) > 2 * MOST_PLACES:
                self._path = self._path[::2]
            self._pose = np.round(world_from_camera, 6).ravel().tolist()

    def add_parts(self, parts: tuple[SurfacePart, ...]) -> None:
        with self._lock:
            for part in parts:
                self._parts[part.number] = part
            while len(self._parts) > MOST_PARTS:
                del self._parts[min(self._parts)]
                self._forgotten += 1

    def forget_map(self, number: int) -> None:
        """Take down what was shown of a map that turned out to be wrong."""
        with self._lock:
            self._parts = {key: part for key, part in self._parts.items() if part.map_number != number}
            if self._review is not None and self._review.map_number == number:
                self._review = None
            if number == self._map_number:
                self._path, self._pose = [], []

    def add_review(self, review: Review) -> None:
        with self._lock:
            self._review = review

    def add_latency(self, seconds: float) -> None:
        with self._lock:
            self.latencies.append(seconds)
            del self.latencies[:-MOST_LATENCIES]

    def show_frame(self, rgb: NDArray[np.uint8], name: str = "frame.jpg", always: bool = False) -> None:
        """A picture (H,W,3) for the page, now and then, while somebody looks."""
        now = time.monotonic()
        if not always and (now - self._painted < SHOWN_EVERY_S or not self.is_watched):
            return
        if not always:
            self._painted = now
        coded = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
        self.keep_picture(name, bytes(coded.tobytes()))

    def keep_picture(self, name: str, coded: bytes) -> None:
        with self._lock:
            self._pictures[name] = coded

    def picture(self, name: str) -> bytes | None:
        with self._lock:
            return self._pictures.get(name)

    def surface(self, number: int) -> bytes | None:
        """A part for the page."""
        with self._lock:
            part = self._parts.get(number)
        return None if part is None else part.to_bytes()

    def to_dict(self) -> dict[str, Any]:
        """For the page, which asks for it several times a second."""
        self._asked = time.monotonic()
        with self._lock:
            shown = [part for part in self._parts.values() if self._is_placed(part)]
            label, done, total = self.finishing
            return {
                "name": self.name,
                "phase": self.phase,
                "view": self.view,
                "advice": self.advice,
                "seconds": round(self.seconds, 2),
                "rate": round(self.rate, 1),
                "counts": vars(self.counts),
                "latency": _latency(self.latencies),
                "map": self._map_number,
                "parts": [[part.number, part.version, self._correction(part)] for part in shown],
                "faces": sum(len(part.faces) for part in shown),
                "earlier": len(self._parts) - len(shown) + self._forgotten,
                "path": self._shown_path(),
                "fault": self.fault,
                "pose": self._pose,
                "coverage": self._coverage(),
                "sentences": self.sentences[-6:],
                "finishing": {"label": label, "done": done, "total": total},
                "pictures": sorted(self._pictures),
            }

    def _shown_path(self) -> list[list[float]]:
        """Corrected as far as it was reviewed, then as it was tracked."""
        review, corrected = self._review, list[list[float]]()
        if review is not None and review.map_number == self._map_number:
            corrected = [list(place) for place in review.path]
        reviewed = review.last if review is not None and corrected else -1
        path = corrected + [place for frame, place in self._path if frame > reviewed]
        return path[:: max(1, len(path) // MOST_PLACES)]

    def _is_placed(self, part: SurfacePart) -> bool:
        """Whether a part is of the current map, or of one that was recognised in it."""
        return part.map_number == self._map_number or self._correction(part) is not None

    def _correction(self, part: SurfacePart) -> list[float] | None:
        """Similarity (4,4) by rows that the last review of the current map found for the part; None for none."""
        review = self._review
        if review is None or part.number not in review.corrections or review.map_number != self._map_number:
            return None
        return np.round(review.corrections[part.number], 6).ravel().tolist()

    def _coverage(self) -> dict[str, Any] | None:
        review = self._review
        if review is None or review.map_number != self._map_number:
            return None
        missed = [vars(place) for place in review.missed]
        covered = None if review.covered is None else 100 * review.covered
        found = {"covered": covered, "reason": review.reason, "missed": missed, "more": review.more}
        found |= {"since": review.first_s, "until": review.last_s}
        return found | {"loops": review.loops, "joined": review.joined}


def _latency(seconds: list[float]) -> dict[str, float] | None:
    if not seconds:
        return None
    return {"last": seconds[-1], "median": float(np.median(seconds)), "worst": max(seconds)}
