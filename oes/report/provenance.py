"""Where figures come from, in one line: profile, episodes, seeds, machine. No host name, no
clock.
"""

import os
import platform
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml


def provenance(
    profile: str, episodes: Mapping[str, int], seeds: Mapping[str, int], machine: str
) -> str:
    """The line under every table. ``episodes`` counts those of each split."""
    counts = ", ".join(f"{count} {split}" for split, count in episodes.items())
    numbers = ", ".join(f"{name} {seed}" for name, seed in seeds.items())
    return f"Profile {profile}; episodes: {counts}; seeds: {numbers}; machine: {machine}."


def read_seeds(path: Path) -> dict[str, int]:
    """Every ``seed`` of a params file, by the section it is in."""
    return dict(_seeds(yaml.safe_load(path.read_text(encoding="utf-8")), ()))


def _seeds(tree: Mapping[str, Any], above: tuple[str, ...]) -> Iterator[tuple[str, int]]:
    for key, value in tree.items():
        if key == "seed":
            yield ".".join(above), value
        elif isinstance(value, dict):
            yield from _seeds(value, (*above, key))


def describe_machine() -> str:
    """For instance ``AMD EPYC 7763, 2 cores``; an NVIDIA card is added where its driver lists
    one.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    words = [_processor(), f"{cores} cores", *_cards()]
    return ", ".join(words)


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return " ".join(line.split(":", 1)[1].split())
    return platform.processor() or platform.machine()


def _cards() -> list[str]:
    found = sorted(Path("/proc/driver/nvidia/gpus").glob("*/information"))
    lines = [
        line
        for path in found
        for line in path.read_text(encoding="utf-8", errors="replace").splitlines()
    ]
    return [" ".join(line.split(":", 1)[1].split()) for line in lines if line.startswith("Model:")]
