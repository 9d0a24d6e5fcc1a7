"""Per-user cache of computed arrays and compiled code, in a folder that only this user can write."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from posetrack_cli.npz import Arrays, NpzError, read_npz


def cache_folder(name: str) -> Path | None:
    """Return the cache folder of this name: in NUMBA_CACHE_DIR, the user's cache or a temporary folder.

    A folder in NUMBA_CACHE_DIR is also used if it exists and cannot be written, as in a container image. None
    if there is neither that nor a writable folder.
    """
    chosen = _chosen()
    if chosen is not None and (chosen / name).is_dir():
        return chosen / name
    return next((parent / name for parent in _parents() if _is_writable(parent / name)), None)


def cached_arrays(
    name: str, sources: Sequence[str], arguments: Sequence[object], compute: Callable[[], Arrays]
) -> Arrays:
    """Return the arrays of an expensive computation, from the cache if available.

    Args:
        name: name of the computation.
        sources: source files the computation depends on; any change invalidates the cache.
        arguments: all arrays and plain values the result depends on.
        compute: the computation.
    """
    folder = cache_folder(name)
    if folder is None:
        return compute()
    path = folder / f"{_key(sources, arguments)}.npz"
    with suppress(OSError, NpzError), path.open("rb") as stream:
        return read_npz(stream)
    arrays = compute()
    with suppress(OSError):  # the cache is optional, e.g. on a full disk
        _write(path, arrays)
    return arrays


def _key(sources: Sequence[str], arguments: Sequence[object]) -> str:
    digest, root = hashlib.sha256(np.__version__.encode()), Path(__file__).parent
    for source in sources:
        digest.update((root / source).read_bytes())
    for argument in arguments:
        if isinstance(argument, np.ndarray):
            digest.update(repr((argument.dtype.str, argument.shape)).encode())
            digest.update(np.ascontiguousarray(argument).tobytes())
        else:
            digest.update(repr(argument).encode())
    return digest.hexdigest()[:32]


def _write(path: Path, arrays: Arrays) -> None:
    """Write a file atomically."""
    descriptor, written = tempfile.mkstemp(dir=path.parent, suffix=".part")
    part = Path(written)
    try:
        with os.fdopen(descriptor, "wb") as stream:
            np.savez(stream, **arrays)  # type: ignore[arg-type]
        part.replace(path)
    except BaseException:
        with suppress(OSError):
            part.unlink()
        raise


def _parents() -> Iterator[Path]:
    chosen, caches = _chosen(), os.environ.get("XDG_CACHE_HOME")
    if chosen is not None:
        yield chosen
    if caches:
        yield Path(caches) / "posetrack"
    else:
        yield Path(os.path.expanduser("~")) / ".cache" / "posetrack"  # noqa: PTH111 Path.home() may raise
    with suppress(FileNotFoundError):  # no temporary folder is writable
        temporary = Path(tempfile.gettempdir()) / f"posetrack-{_user()}"
        if _is_own(temporary):
            yield temporary


def _chosen() -> Path | None:
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    return Path(chosen) / "posetrack" if chosen else None


def _user() -> int:
    return os.getuid() if hasattr(os, "getuid") else 0


def _is_writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


def _is_own(folder: Path) -> bool:
    """Return whether only this user can put code into the folder, as cached code is executed."""
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
    except OSError:
        return False
    return folder.is_dir() and status.st_uid == _user() and not status.st_mode & 0o022
