"""Compiled inner loops: numba with a cache that any change of any kernel empties.

Numba's own cache looks at the file of the function that is called, not at those of the functions it calls
in turn nor at constants from elsewhere, and would go on with old ones. So the compiled code lies in a folder
that is named after all the sources that go into it.
"""

from __future__ import annotations

import functools
import itertools
import os
import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Lock
from time import perf_counter
from typing import Any, TypeVar

from posetrack_cli.build import source_digest
from posetrack_cli.cache import cache_folder

Function = TypeVar("Function", bound=Callable[..., Any])

KERNEL_SOURCES = (
    "compiled.py",
    "geometry/kernels.py",
    "geometry/least_squares.py",
    "hand/model/anatomy.py",
    "hand/fit/*.py",
    "hand/observe/observation.py",
    "rendering/cpu.py",
    "rendering/pixel_model.py",
    "rendering/port.py",
    "rendering/raster.py",
    "head/detection/appearance.py",
    "head/face/templates.py",
    "head/face/points.py",
    "head/face/rig_images.py",
    "head/particles/score_maps.py",
    "head/refinement/*.py",
    "head/skin/equations.py",
    "head/adjustment/*.py",
    "recording/compression.py",
    "tracking/velocity.py",
    "units.py",
)
"""Files that compiled code is made of, constants included."""
_MOST_THREADS = 8
THREADS_VARIABLE = "POSETRACK_THREADS"
# No error is raised for a division by zero. No fastmath: which copy of an inner function runs, and so in
# which order fastmath would add up, depends on what was compiled or loaded before: equal runs, unequal bits.
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}


def kernel(function: Function) -> Function:
    """Compile a function of arrays and numbers at its first call; it releases the interpreter's lock."""
    return _compiled(function)


def inlined(function: Function) -> Function:
    """The same for a small function that is called per pixel: its code goes into its callers."""
    return _compiled(function, forceinline=True)


def _compiled(function: Function, **options: Any) -> Function:
    import numba
    import numba.core.config

    compiled: Any = numba.njit(**_OPTIONS, **options)(function)
    compiled.get_call_template = functools.partial(_for_any_value, compiled.get_call_template)
    config: Any = numba.core.config  # its settings are set at run time, unknown to type checkers
    folder, others = kernel_folder(), config.CACHE_DIR
    if folder is not None:
        config.CACHE_DIR = folder
        try:
            compiled._cache = _cache_class()(compiled.py_func)
        finally:
            config.CACHE_DIR = others
    dispatcher: Function = compiled
    return dispatcher


def _for_any_value(template: Callable[..., Any], args: Any, kws: Any) -> Any:
    """Take what calls a kernel by its type alone: else each constant handed on would be compiled for anew."""
    import numba.core.types

    types: Any = numba.core.types  # without types of their own
    plain = {name: types.unliteral(a) for name, a in kws.items()}
    return template([types.unliteral(a) for a in args], plain)


@functools.cache
def _cache_class() -> type[Any]:
    """Numba's cache, but for what it takes for granted: whole files, a disk with room, and one writer."""
    from numba.core import caching

    FunctionCache: Any = caching.FunctionCache  # without types

    class KernelCache(FunctionCache):  # type: ignore[misc]
        """What cannot be read is compiled anew, what cannot be kept is not."""

        def load_overload(self, sig: Any, target_context: Any) -> Any:
            """Return the compiled code of a signature, None where there is none that can be used."""
            try:
                return super().load_overload(sig, target_context)
            except Exception:  # damaged bytes raise whatever pickle makes of them
                with suppress(OSError):
                    self.flush()  # else it would be found damaged once more
                return None

        def save_overload(self, sig: Any, data: Any) -> None:
            """Keep compiled code; two processes do not number their files at the same time."""
            with suppress(OSError, EOFError, pickle.PickleError), _alone(Path(self.cache_path)):
                super().save_overload(sig, data)

    return KernelCache


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    from filelock import lock_descriptor

    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("wb") as stream:
        with suppress(OSError):  # there are file systems without locks
            lock_descriptor(stream.fileno())
        yield


@contextmanager
def announced(
    report: Callable[[str], None], each: Callable[[int], None] = lambda count: None
) -> Iterator[None]:
    """Say so, once, when a kernel is compiled: the first run after a change waits for it.

    Nothing is said where the compiled code is loaded from the cache.

    Args:
        report: called with a line for people, in the thread that compiles.
        each: called with the number of each kernel, from 1, in the same thread.
    """
    kept = "once" if kernel_folder() else "in every run, as nothing can be kept"
    counts = itertools.count(1)

    def say() -> None:
        if (count := next(counts)) == 1:
            report(f"compiling the fits, {kept}: about 75 s of processor time")
        each(count)

    with _listening(say, lambda: None):
        yield


@contextmanager
def watched(start: Callable[[], None]) -> Iterator[Callable[[], bool]]:
    """Yield a function that tells whether any thread compiles a kernel just now.

    The time in which one does is added to ``compiling_s``.

    Args:
        start: called before each, in the thread that compiles; may raise.
    """
    depth, began_s, lock = [0], [0.0], Lock()

    def change(by: int) -> None:
        with lock:
            if depth[0] == 0:
                began_s[0] = perf_counter()
            depth[0] += by
            if depth[0] == 0:
                _compiling_s[0] += perf_counter() - began_s[0]

    def begin() -> None:
        change(1)
        start()

    with _listening(begin, lambda: change(-1)):
        yield lambda: depth[0] > 0


_compiling_s = [0.0]


def compiling_s() -> float:
    """Return for how many seconds this process has compiled kernels while that was ``watched``."""
    return _compiling_s[0]


@contextmanager
def _listening(start: Callable[[], None], end: Callable[[], None]) -> Iterator[None]:
    """Call functions when the compilation of a kernel starts and ends, in the thread that compiles it."""
    import numba.core.event

    event: Any = numba.core.event
    listener = event.RecordingListener()
    listener.on_start, listener.on_end = (lambda _: start()), (lambda _: end())
    with event.install_listener("numba:compile", listener):
        yield


def thread_count() -> int:
    """Return how many threads share compiled work: one for each core that this process may use, 8 at most.

    Whoever starts several processes at a time says how many each may have, in POSETRACK_THREADS. Results do
    not depend on it.
    """
    told = os.environ.get(THREADS_VARIABLE, "")
    if told.isdecimal() and 0 < int(told) <= _MOST_THREADS:
        return int(told)
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(allowed, _MOST_THREADS)


@functools.cache
def kernel_folder() -> str | None:
    """Return where compiled code is kept; None where nothing can be kept."""
    folder = cache_folder(source_digest(KERNEL_SOURCES))
    return None if folder is None else str(folder)
