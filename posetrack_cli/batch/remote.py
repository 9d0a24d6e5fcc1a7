"""Recordings in object stores and on web servers, through fsspec: one local copy per running job."""

from __future__ import annotations

import json
import posixpath
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from posetrack_cli import limits
from posetrack_cli.errors import RecordingError, UsageError

SCHEMES = ("gs", "https", "s3")
_CHAIN = "::"  # fsspec's syntax for nested file systems, which could open local files
_MAGIC = "*["
_BLOCK_BYTES = 4 * limits.MIB
# Entries of fsspec's file information that change with the content, by file system
_STAMPS = ("ETag", "etag", "md5Hash", "LastModified", "mtime", "updated", "last_modified")
Value = TypeVar("Value")


def is_url(text: str) -> bool:
    """Whether a name of a recording is a URL."""
    return "://" in text


class Found(NamedTuple):
    """A remote file.

    Attributes:
        url: its URL.
        name: its path without extension, relative to the part of a pattern without wildcards.
        file: its file name.
    """

    url: str
    name: str
    file: str


def find(url: str) -> list[Found]:
    """Return the files of a URL or pattern (``*``, ``[...]``; a ``?`` begins the query of a URL).

    Raises:
        UsageError: an unknown scheme, or nothing matches.
        RecordingError: the server cannot be read.
    """
    scheme = url.partition("://")[0]
    if scheme not in SCHEMES or _CHAIN in url:
        expected = " or ".join(f"{name}://" for name in SCHEMES)
        raise UsageError("recording has an unknown kind of URL", where=url, expected=expected)
    system, path = _opened(url)
    pattern = min((path.index(sign) for sign in _MAGIC if sign in path), default=None)
    if pattern is None:
        return [_found(url, "")]
    found = _tried(url, lambda: sorted(system.glob(path)))
    if len(found) > limits.SEARCH_ENTRIES:
        raise UsageError(
            "pattern matches too many files", where=url, expected=f"at most {limits.SEARCH_ENTRIES}"
        )
    if not found:
        raise UsageError("no matching recording", where=url)
    fixed = system.unstrip_protocol(posixpath.dirname(path[:pattern]))
    return [_found(system.unstrip_protocol(one), fixed) for one in found]


def _found(url: str, fixed: str) -> Found:
    """Return a file with its name relative to a folder, or its own name without one."""
    below = _path_of(url)
    file = posixpath.basename(below)
    if fixed:
        below = posixpath.relpath(below, _path_of(fixed) or ".")
    return Found(url, str(Path(below if fixed else file).with_suffix("")), file)


def _path_of(url: str) -> str:
    """Return host or bucket and path, without a query."""
    return url.partition("://")[2].partition("?")[0]


def stamp(url: str) -> str:
    """Return the size of a remote file and all that its file system states about its version.

    Raises:
        RecordingError: the file cannot be read, or is a folder.
    """
    system, path = _opened(url)
    info = _tried(url, lambda: system.info(path))
    if info.get("type") == "directory":
        raise RecordingError("remote recording is a folder", where=url, expected="a file")
    return json.dumps([url, info.get("size"), *(str(info[name]) for name in _STAMPS if name in info)])


class CopyStoppedError(Exception):
    """Copying was stopped or refused."""


@contextmanager
def local_copy(url: str, path: Path, stopped: Callable[[], bool]) -> Iterator[Callable[[], None]]:
    """Yield a function that copies a remote file to a path once; the copy is deleted at the end.

    Args:
        url: of the file.
        path: of the copy.
        stopped: polled for each block; returns True to stop.

    Raises:
        RecordingError: the file cannot be read (by the function).
        OSError: the copy cannot be written.
        CopyStoppedError: stopped.
    """

    def copy() -> None:
        if copied:
            return
        system, remote = _opened(url)
        with path.open("wb") as local, _tried(url, lambda: system.open(remote, "rb")) as stream:
            while block := _tried(url, lambda: stream.read(_BLOCK_BYTES)):
                if stopped():
                    raise CopyStoppedError
                local.write(block)
        copied.append(path)

    copied: list[Path] = []
    try:
        yield copy
    finally:
        path.unlink(missing_ok=True)


def _opened(url: str) -> tuple[Any, str]:
    try:
        from fsspec.core import url_to_fs
    except ModuleNotFoundError:
        raise UsageError(
            "remote recordings require fsspec", where=url, hint="pip install 'posetrack[batch]'"
        ) from None
    system, path = _tried(url, lambda: url_to_fs(url))
    return system, path


def _tried(url: str, work: Callable[[], Value]) -> Value:
    """Return the value of a call into a file system, whose libraries raise errors of their own."""
    try:
        return work()
    except ImportError as error:  # fsspec names the missing package
        raise UsageError("URL cannot be read", where=url, found=error) from error
    except Exception as error:
        raise RecordingError("cannot be read", where=url, found=error or type(error).__name__) from error
