"""bfloat16 on the devices that compute with it natively."""

from functools import cache

import torch


def half_precision(device: torch.device, is_wanted: bool = True) -> torch.autocast:
    """Autocast to bfloat16 on GPUs and on CPUs with AMX (6 to 8 times as fast as float32 there).

    Other CPUs emulate bfloat16, a hundred times slower than float32, and stay in float32.
    """
    return torch.autocast(
        device.type, dtype=torch.bfloat16, enabled=is_wanted and has_bfloat16(device.type)
    )


@cache
def has_bfloat16(kind: str) -> bool:
    """Whether a type of device (``cpu``, ``cuda``) computes with bfloat16 natively."""
    if kind != "cpu":
        return True
    return bool(torch._C._has_mkldnn and torch.ops.mkldnn._is_mkldnn_bf16_supported())
