"""The record of a training run: a line to read, a CSV to plot, TensorBoard events where TensorBoard is installed."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

Say = Callable[[str], None]
HEADER = ["step", "loss", "learning_rate", "held_out_abs_rel"]


class TrainLog:
    """Writes `OUT.log.csv` and, with `pip install 'haustra[train]'`, the folder `OUT.tensorboard`."""

    def __init__(self, out: Path, say: Say) -> None:
        self._csv = out.with_suffix(".log.csv")
        self._say = say
        self._events = _summary_writer(out.with_suffix(".tensorboard"))

    def write(self, step: int, steps: int, loss: float, rate: float, held_out: float | None) -> None:
        """Loss since the last line, learning rate, and the held-out meshes' abs.REL (a fraction) if it was measured."""
        text = f"step {step}/{steps}  loss {loss:.4f}"
        self._say(text if held_out is None else f"{text}  held-out abs.REL {100 * held_out:.2f} %")
        new = not self._csv.exists()
        with self._csv.open("a", newline="") as file:
            writer = csv.writer(file)
            if new:
                writer.writerow(HEADER)
            writer.writerow([step, loss, rate, "" if held_out is None else held_out])
        if self._events is not None:
            for name, value in zip(HEADER[1:], (loss, rate, held_out), strict=True):
                if value is not None:
                    self._events.add_scalar(name, value, step)
            self._events.flush()


def _summary_writer(folder: Path) -> Any:
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return None
    return SummaryWriter(str(folder))
