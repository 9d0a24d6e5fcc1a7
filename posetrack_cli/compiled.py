"""Compiled inner loops: numba with a cache that any change of any kernel empties.

Numba's own cache looks at the file of the function that is called, not at those of the functions it calls
in turn, and would go on with an old callee. So the compiled code lies in a folder of the user's cache
directory that is named after the sources of all kernels.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])

KERNEL_FOLDERS = ("hand/fitting",)
# No error is raised for a division by zero; sums may be reordered, but NaN and infinity keep their meaning.
_OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "arcp", "nsz"},
}


def kernel(function: Function) -> Function:
    """Compile a function of arrays and numbers when it is first called; it releases the interpreter's lock."""
    return _compiled(function)


def inlined(function: Function) -> Function:
    """The same for a small function that is called per pixel: its code goes into its callers."""
    return _compiled(function, forceinline=True)


def _compiled(function: Function, **options: Any) -> Function:
    import numba

    _choose_cache_folder()
    compiled: Function = numba.njit(cache=True, **_OPTIONS, **options)(function)
    return compiled


def _choose_cache_folder() -> None:
    from numba.core import config

    if "NUMBA_CACHE_DIR" not in os.environ:
        config.CACHE_DIR = str(_user_cache() / "posetrack" / _digest())


def _user_cache() -> Path:
    chosen = os.environ.get("XDG_CACHE_HOME")
    return Path(chosen) if chosen else Path.home() / ".cache"


def _digest() -> str:
    root = Path(__file__).parent
    sources = sorted(path for folder in KERNEL_FOLDERS for path in (root / folder).glob("*.py"))
    content = b"".join(path.read_bytes() for path in sources)
    return hashlib.sha256(content).hexdigest()[:16]
