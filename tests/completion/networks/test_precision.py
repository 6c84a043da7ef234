"""Which number format a network is run in."""

import pytest
import torch

from completion.networks import precision as formats
from completion.networks.precision import choose_precision
from haustra.core.errors import CompletionError


def test_without_such_a_processor_the_next_best_is_taken(monkeypatch):
    cpu = torch.device("cpu")
    monkeypatch.setattr(formats, "can_use_int8", lambda: True)
    assert [choose_precision(p, cpu) for p in ("auto", "int8", "bf16", "fp32")] == ["int8", "int8", "bf16", "fp32"]
    assert choose_precision("auto", torch.device("cuda")) == "bf16"
    monkeypatch.setattr(formats, "can_use_int8", lambda: False)
    monkeypatch.setattr(formats, "has_fast_bfloat16", lambda device: False)
    assert choose_precision("auto", cpu) == "fp32"
    with pytest.raises(CompletionError, match="VNNI"):
        choose_precision("int8", cpu)
