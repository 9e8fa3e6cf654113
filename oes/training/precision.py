"""Half precision where it is fast, and nowhere else."""

from functools import cache

import torch


def half_precision(device: torch.device, is_wanted: bool = True) -> torch.autocast:
    """Autocast to bfloat16 where that is fast: six to eight times on CPUs with AMX, and on GPUs
    with tensor cores.

    CPUs that cannot calculate with bfloat16 imitate it, a hundred times slower than float32: there,
    and where it is not wanted, all stays in float32.
    """
    return torch.autocast(
        device.type, dtype=torch.bfloat16, enabled=is_wanted and has_bfloat16(device.type)
    )


@cache
def has_bfloat16(kind: str) -> bool:
    """Whether a kind of device (``cpu``, ``cuda``) calculates with bfloat16 itself."""
    if kind != "cpu":
        return True
    return bool(torch._C._has_mkldnn and torch.ops.mkldnn._is_mkldnn_bf16_supported())
