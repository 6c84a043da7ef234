"""Errors of depth completion against true depth, per frame and in mean, under a stated protocol; calibration of the
predicted error; plots. The command `haustra evaluate` is `run.evaluate`."""

from typing import TYPE_CHECKING

from haustra.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from completion.evaluation.accumulator import Accumulator as Accumulator
    from completion.evaluation.evaluate import Protocol as Protocol
    from completion.evaluation.evaluate import evaluate_frames as evaluate_frames
    from completion.evaluation.evaluate import mean_errors as mean_errors
    from completion.evaluation.metrics import depth_errors as depth_errors
    from completion.evaluation.predictors import Predictor as Predictor
    from completion.evaluation.predictors import load_predictor as load_predictor

_MODULE_OF = {
    "Accumulator": "completion.evaluation.accumulator",
    "Predictor": "completion.evaluation.predictors",
    "Protocol": "completion.evaluation.evaluate",
    "depth_errors": "completion.evaluation.metrics",
    "evaluate_frames": "completion.evaluation.evaluate",
    "load_predictor": "completion.evaluation.predictors",
    "mean_errors": "completion.evaluation.evaluate",
}
__all__ = ["Accumulator", "Predictor", "Protocol", "depth_errors", "evaluate_frames", "load_predictor", "mean_errors"]
__getattr__ = lazy_names(__name__, _MODULE_OF)
