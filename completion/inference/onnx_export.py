"""Export of a `DepthNetwork` as an ONNX graph, for programs without torch.

Inputs and outputs are those of a `DepthNetwork`'s `folded` copy, for a batch of any size at one fixed image size. The
file's description says what `DepthCompleter` computes around it.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from completion.networks.protocol import DepthNetwork, Estimate, most_iterations
from haustra.core.errors import CompletionError

INPUTS, OUTPUTS = ("rgb", "log_sparse", "trust"), ("log_depth", "log_error")
LAST = ("last_log_depth", "last_log_error")
DESCRIPTION = (
    "rgb: (B,3,H,W) in [0,1]; an image whose lit pixels (brightest channel over 16/255) are not 130/255 bright in "
    "the mean is first multiplied by a factor from 0.5 to 2 that makes them so, and rounded to 255ths. log_sparse: "
    "(B,1,H,W), log(depth / median), 0 where there is no point; median: of the frame's sparse depths, the lower of "
    "the middle two. trust: (B,1,H,W), 0 where there is no point, 1 at points, or e0^2 / (e0^2 + e^2) with e0 = "
    "0.03 where a point's relative error e is known. Depth = median * exp(log_depth); exp(log_error) is the "
    "relative error that is expected. An image that is completed at another size is resized before, points by (p +"
    " 0.5) * factor."
)
RECURRENT_USE = (
    " For a further iteration run the recurrent graph: its last_log_depth and last_log_error are these outputs."
)


def export_onnx(network: DepthNetwork, path: Path, side: int, recurrent: bool = False) -> Path:
    """Write a graph for square images of `side` px; CompletionError without the onnx packages or for another side.

    `recurrent`: the graph of iterations after the first; CompletionError if the network was trained for one iteration.
    """
    if side <= 0 or side % network.stride:
        raise CompletionError(f"the image side must be a multiple of {network.stride} px, not {side}")
    try:
        import onnx
        import onnxscript  # noqa: F401
    except ImportError:
        raise CompletionError("exporting to ONNX needs further packages: pip install 'haustra[onnx]'") from None
    folded = network.folded(recurrent)

    def inputs_of(make: Callable[[int], Any]) -> tuple[Any, ...]:
        """`make` of the number of channels of each input."""
        last = (Estimate(make(1), make(1)),) if recurrent else ()
        return (make(3), make(1), make(1), *last)

    batch = torch.export.Dim("batch")
    program = torch.onnx.export(
        folded,
        inputs_of(lambda channels: torch.zeros(2, channels, side, side)),
        input_names=[*INPUTS, *(LAST if recurrent else ())],
        output_names=list(OUTPUTS),
        dynamic_shapes=inputs_of(lambda channels: {0: batch}),
        dynamo=True,
        verbose=False,
    )
    assert program is not None
    model = program.model_proto
    model.doc_string = DESCRIPTION + RECURRENT_USE * (most_iterations(network.config) > 1)
    onnx.save(model, path)
    return path
