"""The scale-free network as an ONNX graph, for programs without torch.

Inputs and outputs are those of `ScaleFreeMSCSANet.forward`, for a batch of any size at one fixed image size: what
`DepthCompleter` does around it (exposure, logarithm over the median, confidence) is a few lines of array code. What
those are is written into the file's description.
"""

from __future__ import annotations

import copy
from pathlib import Path

import torch

from completion.errors import CompletionError
from completion.infer import fold_batch_norm
from completion.scale_free import STRIDE, ScaleFreeMSCSANet

INPUTS, OUTPUTS = ("rgb", "log_sparse", "trust"), ("log_depth", "log_error")
DESCRIPTION = (
    "rgb: (B,3,H,W) in [0,1]. log_sparse: (B,1,H,W), log(depth / median of the sparse depths), 0 where there is "
    "no point. trust: (B,1,H,W), 1 at points, 0 elsewhere. Depth = median * exp(log_depth); exp(log_error) is the "
    "predicted relative error."
)


def export_onnx(network: ScaleFreeMSCSANet, path: Path, side: int) -> Path:
    """Write a graph for square images of `side` px; CompletionError without the onnx packages or for another side."""
    if side <= 0 or side % STRIDE:
        raise CompletionError(f"the image side must be a multiple of {STRIDE} px, not {side}")
    try:
        import onnx
        import onnxscript  # noqa: F401
    except ImportError:
        raise CompletionError("exporting to ONNX needs further packages: pip install 'haustra[onnx]'") from None
    example = (torch.rand(2, 3, side, side), torch.zeros(2, 1, side, side), torch.zeros(2, 1, side, side))
    program = torch.onnx.export(
        fold_batch_norm(copy.deepcopy(network).eval()),
        example,
        input_names=list(INPUTS),
        output_names=list(OUTPUTS),
        dynamic_shapes=tuple({0: torch.export.Dim("batch")} for _ in example),
        dynamo=True,
        verbose=False,
    )
    assert program is not None
    model = program.model_proto
    model.doc_string = DESCRIPTION
    onnx.save(model, path)
    return path
