"""The one way this package compiles a function: with numba, cached beside the source."""

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
    """``function`` as machine code with the same signature and strict IEEE arithmetic: equal input,
    equal bytes. It lets other threads run meanwhile.
    """
    return cast(Function, njit(cache=True, nogil=True, error_model="numpy")(function))


def cache_dir(package: Path) -> Path:
    """Where machine code of ``package`` is kept: one folder for each state of all sources of
    compiled functions.

    numba itself looks at the file of a function alone, and would run old code of what that calls in
    other files.
    """
    sources = [path.read_bytes() for path in sorted(package.rglob("*.py"))]
    digest = hashlib.blake2b(b"\0".join(text for text in sources if b"@jit" in text), digest_size=8)
    return package / "__pycache__" / f"numba-{digest.hexdigest()}"


if not vars(numba.config)["CACHE_DIR"] and os.access(PACKAGE, os.W_OK):
    vars(numba.config)["CACHE_DIR"] = str(cache_dir(PACKAGE))
