"""The files that an evaluation writes, checked before its work."""

import os
from collections.abc import Mapping
from dataclasses import astuple, dataclass
from pathlib import Path

from completion.evaluation.plots import check_plot
from completion.evaluation.predictors import Predictor
from haustra.core.errors import CompletionError


@dataclass(frozen=True)
class Outputs:
    """Files to write; None: not written."""

    csv: Path | None = None
    json: Path | None = None
    sheet: Path | None = None
    sweep: Path | None = None
    calibration: Path | None = None
    compare: Path | None = None
    attention: Path | None = None

    def make_way(self) -> None:
        """Create the files' folders; CompletionError for a file that cannot be written, before any work, and before
        any folder where the names alone say so."""
        given = [Path(path) for path in astuple(self) if path is not None]
        twice = [path for path in given if sum(path.resolve() == other.resolve() for other in given) > 1]
        if twice:
            raise CompletionError(f"two outputs are one file, {twice[0]}: the later would replace the earlier")
        for path in filter(None, (self.sheet, self.sweep, self.calibration, self.compare, self.attention)):
            check_plot(path)
        for path in given:
            if path.is_dir():
                raise CompletionError(f"cannot write {path}: it is a folder")
        for path in given:
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise CompletionError(f"cannot write {path}: {error.strerror}") from None
            if not os.access(path if path.exists() else path.parent, os.W_OK):
                raise CompletionError(f"cannot write {path}: it is not allowed")

    def check_models(self, predictors: Mapping[str, Predictor]) -> None:
        """CompletionError for a plot that none of the models can fill, before any work."""
        from completion.networks.channel_attention import structure_awareness_of

        networks = [predictor.network for predictor in predictors.values() if predictor.network is not None]
        if self.calibration and not any(predictor.predicts_error for predictor in predictors.values()):
            raise CompletionError("none of these models predicts its own error: nothing to calibrate")
        if self.attention and all(structure_awareness_of(network) is None for network in networks):
            raise CompletionError("none of these models has channel attention: nothing for --attention to show")
