"""Timeline of a video: manoeuvres of the scope and events in front of the lens, each in a slot of its own.

Slots do not overlap, so that a failure of a method on the video has one cause.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haustra.core.errors import PhantomError
from haustra.phantom.config import EventsConfig, MotionConfig

RAMP = 0.3  # share of a slot over which the strength rises, and over which it falls
LOOK_BACK_LENGTHS = 3.0  # duration of a look-back over that of the other manoeuvres
MIN_GAP = 0.25  # gap before a slot over its length
MANOEUVRES = {"pause": "pauses", "touch": "touches", "quick_turn": "quick_turns", "look_back": "look_backs"}
EVENTS = {
    "red_out": "red_outs",
    "water_jet": "water_jets",
    "bubbles": "bubbles",
    "tool": "tools",
    "peristalsis": "peristalsis",
}


@dataclass(frozen=True)
class Slot:
    """A manoeuvre or event from frame `first` to `last`, both included. `number` seeds what is random in it."""

    kind: str
    first: int
    last: int
    number: int

    def part(self, frame: float) -> float:
        """Share of the slot that has passed at a frame: 0 to 1 inside it, beyond that outside."""
        return (frame - self.first) / max(self.last - self.first, 1)

    def strength(self, frame: float) -> float:
        """Strength at a frame: 0 outside the slot, 1 in its middle, with cosine ramps."""
        nearest_end = min(self.part(frame), 1 - self.part(frame))
        return float(0.5 - 0.5 * np.cos(np.pi * np.clip(nearest_end / RAMP, 0, 1)))


def plan_timeline(motion: MotionConfig, events: EventsConfig, seed: int) -> list[Slot]:
    """Slots in order of time: shuffled kinds, jittered gaps. PhantomError if they do not fit the film."""
    rng = np.random.default_rng([seed, 5])
    kinds = _kinds(motion, events)
    lengths = {kind: _length(kind, motion, events) for kind in set(kinds)}
    needed = frames_needed(motion, events)
    if needed > motion.frames:
        raise PhantomError(
            f"{len(kinds)} manoeuvres and events need {needed:.0f} frames with the gaps between them; "
            f"the film has {motion.frames}"
        )
    order = [kinds[i] for i in rng.permutation(len(kinds))]
    shares = rng.dirichlet(np.full(len(kinds) + 1, 4.0))  # of the spare time before, between and after the slots
    spare, place, slots = motion.frames - needed, 0.0, []
    for number, (kind, share) in enumerate(zip(order, shares)):
        place += spare * share + MIN_GAP * lengths[kind]
        first = int(place)
        place += lengths[kind]
        slots.append(Slot(kind, first, min(int(place), motion.frames - 1), number))
    return slots


def frames_needed(motion: MotionConfig, events: EventsConfig) -> float:
    """Length of the shortest film that all slots fit into."""
    return sum(_length(kind, motion, events) * (1 + MIN_GAP) for kind in _kinds(motion, events))


def _kinds(motion: MotionConfig, events: EventsConfig) -> list[str]:
    """Kind of every slot that the config asks for."""
    counts = {kind: getattr(motion, name) for kind, name in MANOEUVRES.items()}
    counts |= {kind: getattr(events, name) for kind, name in EVENTS.items()}
    return [kind for kind, count in counts.items() for _ in range(count)]


def _length(kind: str, motion: MotionConfig, events: EventsConfig) -> float:
    """Frames of one slot."""
    seconds = motion.manoeuvre_s if kind in MANOEUVRES else events.duration_s
    if kind == "look_back":
        seconds *= LOOK_BACK_LENGTHS
    return max(4.0, seconds * motion.fps)
