"""Compilation of numeric kernels with numba, cached beside the source."""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, cast

import numba
from numba import njit

Function = TypeVar("Function", bound=Callable[..., object])

PACKAGE = Path(__file__).parent


def jit(function: Function) -> Function:
    """Compile a function without the GIL, in strict IEEE arithmetic: equal input, equal bytes."""
    return cast(Function, njit(cache=True, nogil=True, error_model="numpy")(function))


def cache_dir(package: Path) -> Path:
    """Folder of the machine code of ``package``: one for each state of all compiled sources.

    numba itself checks only the file of a function, and would keep stale code of its callees in
    other files.
    """
    sources = [path.read_bytes() for path in sorted(package.rglob("*.py"))]
    # Kernels take named tuples, whose fields numba compiles in.
    compiled = [text for text in sources if b"@jit" in text or b"NamedTuple" in text]
    digest = hashlib.blake2b(b"\0".join(compiled), digest_size=8)
    return package / "__pycache__" / f"numba-{digest.hexdigest()}"


if not vars(numba.config)["CACHE_DIR"] and os.access(PACKAGE, os.W_OK):
    vars(numba.config)["CACHE_DIR"] = str(cache_dir(PACKAGE))
