"""Numba kernels, with a cache that is invalidated by a change of any kernel source.

Numba's own cache checks only the file of the called function, not those of its callees or of constants from
other modules, and would reuse stale code. The cache folder is therefore named after a digest of all kernel
sources.
"""

from __future__ import annotations

import functools
import itertools
import os
import pickle
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Lock
from time import perf_counter
from typing import Any, TypeVar, cast

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
    "lanes.py",
    "rendering/cpu.py",
    "rendering/pixel_model.py",
    "rendering/port.py",
    "rendering/raster.py",
    "head/dense/network.py",
    "head/actions.py",
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
"""All files that contribute to compiled code, including constants."""
_MOST_THREADS = 8
THREADS_VARIABLE = "POSETRACK_THREADS"
# error_model numpy: division by zero does not raise. No fastmath: which copy of an inner function runs, and
# thus the summation order under fastmath, depends on what was compiled or loaded before. Equal runs would
# differ in their last bits.
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}


def kernel(function: Function) -> Function:
    """Compile a function of arrays and numbers on its first call; it releases the GIL."""
    return _compiled(function, _nrt=True)


def borrowing(function: Function) -> Function:
    """Compile a kernel that makes and returns no arrays, without counting references to its own.

    Counting costs more than the arithmetic of a small function that is called per pixel.
    """
    return _compiled(function, _nrt=False)


def inlined(function: Function) -> Function:
    """Compile a small per-pixel function like ``borrowing`` and inline it into its callers."""
    return _compiled(function, forceinline=True, _nrt=False)


def _compiled(function: Function, **options: Any) -> Function:
    later: Any = _Kernel(function, options)
    return cast("Function", later)


class _Kernel:
    """A kernel that loads numba when it is first called, or used by another: that takes .3 s and 60 MiB."""

    def __init__(self, function: Callable[..., Any], options: Mapping[str, Any]) -> None:
        functools.update_wrapper(self, function)
        self._options = options

    def __call__(self, *arguments: Any) -> Any:
        return self.dispatcher(*arguments)

    @property
    def _numba_type_(self) -> Any:
        """Type by which numba finds the function in other kernels."""
        return self.dispatcher._numba_type_

    @functools.cached_property
    def dispatcher(self) -> Any:
        """The function as numba calls it."""
        function: Any = self.__wrapped__  # type: ignore[attr-defined]
        try:
            import numba
            import numba.core.config
        except ModuleNotFoundError:  # an installation for evaluation; trackers refuse it
            return function
        compiled: Any = numba.njit(**_OPTIONS, **self._options)(function)
        compiled.get_call_template = functools.partial(_resolved_by_type, compiled.get_call_template)
        config: Any = numba.core.config  # its attributes are created at run time
        folder, others = kernel_folder(), config.CACHE_DIR
        if folder is not None:
            config.CACHE_DIR = folder
            try:
                compiled._cache = _cache_class()(compiled.py_func)
            finally:
                config.CACHE_DIR = others
        return compiled


def _resolved_by_type(template: Callable[..., Any], args: Any, kws: Any) -> Any:
    """Resolve calls by argument types alone; numba would otherwise recompile for each constant argument."""
    import numba.core.types

    types: Any = numba.core.types  # untyped library
    plain = {name: types.unliteral(a) for name, a in kws.items()}
    return template([types.unliteral(a) for a in args], plain)


@functools.cache
def _cache_class() -> type[Any]:
    """Return a numba cache that tolerates damage, read-only folders, full disks and concurrent writers."""
    from numba.core import caching

    FunctionCache: Any = caching.FunctionCache  # untyped library
    in_given_folder: Any = FunctionCache._impl_class._locator_classes[0]

    class Locator(in_given_folder):  # type: ignore[misc]
        """Locator that accepts a folder that can only be read."""

        def ensure_cache_path(self) -> None:
            with suppress(OSError):
                super().ensure_cache_path()

    class Implementation(FunctionCache._impl_class):  # type: ignore[misc]
        _locator_classes = (Locator,)

    class KernelCache(FunctionCache):  # type: ignore[misc]
        """Cache that recompiles on read errors and ignores write errors."""

        _impl_class = Implementation

        def load_overload(self, sig: Any, target_context: Any) -> Any:
            """Return the compiled code of a signature, or None if there is no usable entry."""
            try:
                return super().load_overload(sig, target_context)
            except Exception:  # unpickling damaged bytes can raise anything
                with suppress(OSError):
                    self.flush()  # otherwise the next load fails again
                return None

        def save_overload(self, sig: Any, data: Any) -> None:
            """Store compiled code under a lock, as numba numbers files by reading and rewriting an index."""
            with suppress(OSError, EOFError, pickle.PickleError), _locked(Path(self.cache_path)):
                super().save_overload(sig, data)

    return KernelCache


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    from filelock import lock_descriptor

    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("wb") as stream:
        with suppress(OSError):  # some file systems have no locks
            lock_descriptor(stream.fileno())
        yield


@contextmanager
def announced(
    report: Callable[[str], None], each: Callable[[int], None] = lambda count: None
) -> Iterator[None]:
    """Report once when a kernel is compiled, as the first run after a change waits for it.

    Nothing is reported if the compiled code is loaded from the cache.

    Args:
        report: called with a message, in the compiling thread.
        each: called with the number of each kernel, from 1, in the same thread.
    """
    folder = kernel_folder()
    is_kept = folder is not None and os.access(folder, os.W_OK)
    kept = "cached for later runs" if is_kept else "not cached: no writable cache folder"
    counts = itertools.count(1)

    def say() -> None:
        if (count := next(counts)) == 1:
            report(f"compiling kernels: about 30 s of CPU time, {kept}")
        each(count)

    with _listening(say, lambda: None):
        yield


@contextmanager
def watched(start: Callable[[], None]) -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether any thread is compiling a kernel.

    Compile time is added to ``compiling_s``.

    Args:
        start: called before each compilation, in the compiling thread; may raise.
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
    """Return the seconds this process has spent compiling kernels inside ``watched``."""
    return _compiling_s[0]


@contextmanager
def _listening(start: Callable[[], None], end: Callable[[], None]) -> Iterator[None]:
    """Call ``start`` and ``end`` around each kernel compilation, in the compiling thread."""
    import numba.core.event

    event: Any = numba.core.event
    listener = event.RecordingListener()
    listener.on_start, listener.on_end = (lambda _: start()), (lambda _: end())
    with event.install_listener("numba:compile", listener):
        yield


def thread_count() -> int:
    """Return the number of threads for compiled work: one per available core, 8 at most.

    POSETRACK_THREADS overrides it, e.g. where several processes share a machine. Results do not depend on it.
    """
    override = os.environ.get(THREADS_VARIABLE, "")
    if override.isdecimal() and 0 < int(override) <= _MOST_THREADS:
        return int(override)
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(allowed, _MOST_THREADS)


@functools.cache
def kernel_folder() -> str | None:
    """Return the cache folder of compiled code; None if no cache folder is writable."""
    folder = cache_folder(source_digest(KERNEL_SOURCES))
    return None if folder is None else str(folder)
