"""One live session: frames in, the state for the page out, until the source ends or somebody stops it."""

import time
from collections import deque
from dataclasses import replace
from pathlib import Path

from haustra.core.errors import HaustraError
from haustra.core.threads import single_threaded
from pipeline.config import Config
from pipeline.live.capture.frame_feed import FedFrame, FrameFeed
from pipeline.live.capture.live_film import LiveFilm
from pipeline.live.dense_worker import DenseResult, DenseWorker, LiveCamera, LiveSetup
from pipeline.live.keyboard import first_interrupt_asks
from pipeline.live.live_tracking import LiveTracker
from pipeline.live.page.live_state import LiveState
from pipeline.live.review_worker import Review, ReviewJob, ReviewWorker
from pipeline.live.warm_up import warm_tracking
from pipeline.live.worker import Worker
from pipeline.live.working_view import LOOKED_AT, ViewFinder, WorkingFrame, WorkingView
from pipeline.mapping.submap import Submap
from pipeline.run_folder.workspace import LIVE_FOLDER

READY_S = 120.0  # for the network to load
LAST_S = 20.0  # for the last keyframes, at the end of the source
WAITING_KEYFRAMES = 2  # that wait for the depth; with the one in work they are 1 s of a busy film
REVIEW_EVERY_S = 4.0
WAITING_REVIEWS = 2  # of the map that was left, and of the one that was begun
DENSE_NICENESS, REVIEW_NICENESS = 5, 10  # a frame that is lost cannot be tracked later; depth and reviews can wait
REVIEWED_KEYFRAMES = 400  # of the tracker: a review's time is bounded
RATE_OVER_S = 2.0
SILENT_S = 1.0  # without a frame
NO_VIEW_AFTER = 5  # frames in a row without a usable picture
REMEMBERED_TIMES = 20_000  # frames whose time in the film is known, for what the review says of them

ADVICE = {
    "starting": "move slowly, and sideways a little",
    "lost": "go back to the view that is shown",
    "black": "the picture is black",
    "overexposed": "the picture is overexposed: move away from the wall",
    "red-out": "the lens lies on the wall: pull back",
    "no texture": "nothing can be seen: clean the lens, or move away from the wall",
    "blurred": "the picture is blurred: move slowly",
    "duplicate": "the picture stands still",
    "other layout": "the processor shows the picture elsewhere than at the start: change its layout back",
}


class LiveSession:
    """Use `run` once. What it finds is in `state`; `stop_asked` there ends it."""

    def __init__(self, film: LiveFilm, folder: Path, config: Config, state: LiveState) -> None:
        self.film, self.config, self.state = film, config, state
        self._setup = LiveSetup(config, folder / LIVE_FOLDER)
        self._tracker: LiveTracker | None = None
        self._pace: deque[float] = deque()
        self._unusable = 0
        self._seconds: dict[int, float] = {}  # of frames, by number
        self._keyframes: dict[int, list[int]] = {}  # completed, of the current map
        self._next_review = 0.0
        self._came = 0.0  # when the latest frame came, by time.monotonic(),
        self._began: float | None = None  # and the first that was tracked

    def run(self) -> None:
        """Follow the source until its end. HaustraError where the source showed nothing; what was lost later is in the
        state."""
        with (
            single_threaded(),
            Worker("depth", DenseWorker, self._setup, WAITING_KEYFRAMES, DENSE_NICENESS) as dense,
            Worker("review", ReviewWorker, self._setup, WAITING_REVIEWS, REVIEW_NICENESS) as review,
        ):
            self._dense, self._review = dense, review
            warm_tracking()
            dense.wait_until_ready(READY_S)
            with FrameFeed(self.film) as feed, first_interrupt_asks(self.state.stop_asked):
                self._follow(feed)
            self.state.counts.came, self.state.counts.skipped = feed.came, feed.skipped
            if feed.fault and self.state.counts.came == 0:
                raise HaustraError(feed.fault)
            if feed.fault:
                self.state.say(feed.fault)
            self._end()

    def _follow(self, feed: FrameFeed) -> None:
        finder = ViewFinder(self.config.camera, self.film.recording, self.config.frames)
        self.state.phase = "live"
        while not self.state.stop_asked.is_set() and not feed.ended:
            fed = feed.take(0.1)
            counts = self.state.counts
            counts.came, counts.skipped = feed.came, feed.skipped
            if self._tracker is not None:
                if fed is not None:
                    self._came = fed.came
                    self._began = fed.came if self._began is None else self._began
                    self.state.tracked_s = fed.came - self._began
                    self._look_at(fed, self._tracker)
                self._keep_pace()
                for keyframe in self._tracker.settled(time.monotonic()):
                    self._dense.submit(keyframe)
                self._collect()
            elif fed is not None:
                counts.looked_at += 1
                view = finder.look(fed.raw.seconds, fed.raw.rgb)
                if view is not None:
                    self._begin(view)
        self.state.phase = "ending"
        feed.stop()

    def _begin(self, view: WorkingView) -> None:
        self._tracker = LiveTracker(view, self.config.odometry, self.config.depth, self.config.seed)
        self._came = time.monotonic()
        seen = LiveCamera(view.camera, view.content)
        self._dense.begin(seen)
        self._review.begin(seen)
        self.state.say(f"camera: {view.origin}")
        self._next_review = time.monotonic() + REVIEW_EVERY_S

    def _look_at(self, fed: FedFrame, tracker: LiveTracker) -> None:
        state, raw = self.state, fed.raw
        frame = tracker.view.working_frame(raw.index, raw.seconds, raw.rgb)
        state.seconds = raw.seconds
        self._remember(raw.index, raw.seconds)
        state.show_frame(frame.rgb)
        if frame.verdict != "used":
            self._unusable += 1
            state.counts.unusable += 1
            if self._unusable >= NO_VIEW_AFTER:
                state.view, state.advice = "no view", ADVICE[frame.verdict]
            return
        self._unusable = 0
        before = tracker.map_number
        for keyframe in tracker.process(frame, fed.came):
            self._dense.submit(keyframe)
        self._tell(tracker, frame, before)

    def _tell(self, tracker: LiveTracker, frame: WorkingFrame, map_before: int) -> None:
        """How the tracking goes, for the page."""
        state = self.state
        state.counts.tracked += 1
        for number in tracker.refused:
            state.forget_map(number)
        if tracker.map_number != map_before:
            state.counts.maps += 1
            if tracker.left is not None:
                self._submit_review(*tracker.left)
            self._keyframes = {tracker.map_number: []}
        state.view = tracker.state
        state.advice = ADVICE.get(tracker.state, "")
        world_from_camera = tracker.world_from_camera
        if tracker.state == "tracking" and world_from_camera is not None:
            state.counts.posed += 1
            state.add_pose(frame.number, world_from_camera, tracker.map_number)
        elif tracker.last_keyframe is not None:
            if state.view == "starting":
                state.view, state.advice = "lost", ADVICE["lost"]
            state.show_frame(tracker.last_keyframe.rgb, "back.jpg", always=state.is_watched)
        self._pace.append(time.monotonic())

    def _keep_pace(self) -> None:
        """The rate as it is now, though no frame may come."""
        now = time.monotonic()
        while self._pace and now - self._pace[0] > RATE_OVER_S:
            self._pace.popleft()
        self.state.rate = len(self._pace) / RATE_OVER_S
        if now - self._came > SILENT_S:
            self.state.view, self.state.advice = "no pictures", "the source is silent"

    def _collect(self) -> None:
        """What the other processes have done, and what they may do next."""
        state = self.state
        state.counts.dropped = self._dense.dropped
        for failure in (self._dense.failure, self._review.failure):
            if failure:  # the source is still recorded, and the run at the end is made of that
                state.fault = f"{failure}; the recording goes on"
                state.say(state.fault)
        for result in self._dense.results():
            if result is not None:
                self._show(result)
        for review in self._review.results():
            if review is not None and review.map_number not in self._refused:
                state.counts.reviews += 1
                state.add_review(self._with_times(review))
        if time.monotonic() >= self._next_review and self._review.free:
            self._ask_for_review()

    @property
    def _refused(self) -> set[int]:
        return set() if self._tracker is None else self._tracker.refused

    def _show(self, result: DenseResult) -> None:
        state = self.state
        state.add_parts(tuple(part for part in result.parts if part.map_number not in self._refused))
        if not result.depth_png:
            state.counts.empty += 1
            return
        state.counts.count_keyframe(result.fate)
        if result.fate == "fused":
            state.add_latency(time.monotonic() - result.came)
        state.keep_picture("depth.png", result.depth_png)
        if result.map_number in self._keyframes:
            self._keyframes[result.map_number].append(result.frame)

    def _ask_for_review(self) -> None:
        if self._tracker is None:
            return
        self._next_review = time.monotonic() + REVIEW_EVERY_S
        submap = self._tracker.submap(REVIEWED_KEYFRAMES)
        if submap is not None:
            self._submit_review(self._tracker.map_number, submap)

    def _submit_review(self, number: int, submap: Submap) -> None:
        parts = tuple(part for part in self.state.parts if part.map_number == number)
        keyframes = tuple(self._keyframes.get(number, ()))
        if parts and keyframes:
            self._review.submit(ReviewJob(number, submap, keyframes, parts, frozenset(self._refused)))

    def _end(self) -> None:
        """The keyframes that still wait are completed, so that the last look shows all."""
        if self._tracker is None:
            counts, what = self.state.counts, "was over before it was clear where in them the picture lies"
            if counts.looked_at >= LOOKED_AT:
                what = "was black"
            raise HaustraError(f"{self.film.name} gave {counts.came} frames and {what}")
        for keyframe in self._tracker.finish():
            self._wait_for_room()
            self._dense.submit(keyframe)
        for worker in (self._dense, self._review):
            worker.wait_until_idle(LAST_S)
        self._collect()
        self._ask_for_review()
        self._review.wait_until_idle(LAST_S)
        self._collect()

    def _wait_for_room(self) -> None:
        end = time.monotonic() + LAST_S
        while self._dense.is_full and time.monotonic() < end and not self._dense.failure:
            time.sleep(0.02)

    def _remember(self, number: int, seconds: float) -> None:
        self._seconds[number] = seconds
        if len(self._seconds) > REMEMBERED_TIMES:
            del self._seconds[next(iter(self._seconds))]

    def _with_times(self, review: Review) -> Review:
        missed = (replace(place, seconds=self._seconds.get(place.frame, 0.0)) for place in review.missed)
        first, last = (self._seconds.get(frame, 0.0) for frame in (review.first, review.last))
        return replace(review, missed=tuple(missed), first_s=first, last_s=last)
