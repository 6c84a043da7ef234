"""When a run of unknown length has converged: its held-out error has stopped falling."""

from __future__ import annotations

from dataclasses import dataclass

EVERY = 200  # steps between two measurements of the held-out error
PATIENCE = 5  # measurements without progress that end the full rate
PROGRESS = 0.02  # of the lowest error so far: what counts as progress
COOLING = 1 / 3  # of the steps at the full rate: so many more follow at a tenth of it


@dataclass
class Plateau:
    """The full rate lasts until `PATIENCE` measurements in a row were not `PROGRESS` below the lowest before them, or
    until the last step that leaves room for cooling; then a tenth of the rate, for `COOLING` times as many steps."""

    most_steps: int
    lowest: float = float("inf")  # held-out error, a fraction
    waited: int = 0
    cooled_at: int = 0  # step; 0 while the rate is full

    def update(self, step: int, held_out: float) -> None:
        """Enter the held-out error after `step` steps."""
        if held_out < self.lowest * (1 - PROGRESS):
            self.lowest, self.waited = held_out, 0
        else:
            self.waited += 1
        if not self.cooled_at and (self.waited >= PATIENCE or step >= self.most_steps / (1 + COOLING)):
            self.cooled_at = step

    @property
    def steps(self) -> int:
        """Number of steps of the whole run, as far as it is known."""
        return min(self.most_steps, round(self.cooled_at * (1 + COOLING))) if self.cooled_at else self.most_steps
