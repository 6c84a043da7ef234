"""Number formats of a network's convolutions: which of them a device computes fast."""

import torch

from completion.networks.cpu.int8_unet import can_use_int8
from haustra.core.errors import CompletionError

PRECISIONS = ("int8", "bf16", "fp32")


def choose_precision(precision: str, device: torch.device, known: tuple[str, ...] = PRECISIONS) -> str:
    """The precision asked for, or of "auto": int8 on CPUs that multiply 8-bit integers fast, else bf16 where that is
    fast, else fp32. `known`: those that the network has; CompletionError if another is asked for, or int8 elsewhere."""
    if precision != "auto" and precision not in known:
        raise CompletionError(f"precision is {', '.join(('auto', *known[:-1]))} or {known[-1]}, not {precision!r}")
    if precision in ("bf16", "fp32"):
        return precision
    if "int8" in known and device.type == "cpu" and can_use_int8():
        return "int8"
    if precision == "int8":
        raise CompletionError("int8 needs a CPU with AVX-512 VNNI; use bf16 or fp32")
    return "bf16" if "bf16" in known and has_fast_bfloat16(device) else "fp32"


def has_fast_bfloat16(device: torch.device) -> bool:
    """True on a GPU and on CPUs with native bfloat16; emulated bfloat16 is slower than float32."""
    if device.type != "cpu":
        return True
    capability = getattr(torch.cpu, "_is_avx512_bf16_supported", None)
    return bool(capability and capability())
