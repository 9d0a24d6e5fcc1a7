"""Safe file access: only regular files are read, and symbolic links are never written through.

Reading a named pipe or device in place of a recording would never end; writing through a link would overwrite
its target. Refusals raise ``OSError`` with the reason in ``strerror``, so callers report them like a missing
file.
"""

from __future__ import annotations

import errno
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedRandom, BufferedReader, BufferedWriter
from pathlib import Path
from tempfile import TemporaryDirectory

_KINDS = {
    stat.S_IFIFO: "a named pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


def open_input(path: Path) -> BufferedReader:
    """Open a regular file for reading bytes; never block on pipes or devices.

    Raises:
        OSError: it cannot be opened or is not a regular file.
    """
    return os.fdopen(_opened(path, os.O_RDONLY), "rb")


def begins_with(path: Path, magic: bytes) -> bool:
    """Return whether a regular file starts with the given magic bytes.

    Raises:
        OSError: it cannot be read or is not a regular file.
    """
    with open_input(path) as stream:
        return stream.read(len(magic)) == magic


def read_input(path: Path, most: int) -> bytes:
    """Return the bytes of a regular file.

    Args:
        path: the file.
        most: maximum size in bytes; see ``limits``.

    Raises:
        OSError: it cannot be read, is not a regular file, or is too large.
    """
    with open_input(path) as stream:
        size = os.fstat(stream.fileno()).st_size
        data = stream.read(min(size, most) + 1)  # read() allocates this much at once
    if len(data) > most:
        raise OSError(errno.EFBIG, f"a file of {size} bytes, more than the limit of {most}", str(path))
    return data


def read_text(path: Path, most: int, encoding: str = "utf-8") -> str:
    """Return the text of a regular file.

    Raises:
        OSError: see ``read_input``.
        UnicodeDecodeError: it has another encoding.
    """
    return read_input(path, most).decode(encoding)


def real_path(path: Path) -> Path:
    """Return the resolved path; unlike ``Path.resolve``, do not raise RuntimeError on link cycles."""
    return Path(os.path.realpath(path))


def hint_of_missing(path: Path, of_pattern: str) -> str:
    """Return a hint for a path that does not exist but looks like a URL or a pattern.

    Args:
        path: path as typed.
        of_pattern: hint for a glob pattern that the shell did not expand.
    """
    if re.match(r"[A-Za-z][A-Za-z0-9+.-]+:/", str(path)):  # pathlib collapses the two slashes of a URL
        return "URLs are not supported: download the file first"
    return of_pattern if any(sign in str(path) for sign in "*?[") else ""


def placed_path(path: Path) -> Path:
    """Return the absolute path without resolving links, as link targets have other names.

    Data version control (DVC, git-annex) keeps recordings in a store and links to them.
    """
    return Path(os.path.abspath(path))  # noqa: PTH100 Path.resolve would follow the link


def open_output(path: Path) -> BufferedWriter:
    """Create or truncate a file for writing; refuse a symbolic link.

    Raises:
        OSError: it cannot be opened or is a link.
    """
    return os.fdopen(_writable(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), "wb")


def open_existing(path: Path) -> BufferedRandom:
    """Open an existing file for reading and writing; refuse a symbolic link.

    Raises:
        OSError: it cannot be opened, is a link, or is not a regular file.
    """
    return os.fdopen(_writable(path, os.O_RDWR), "r+b")


def write_output(path: Path, data: bytes) -> None:
    """Write a file through ``open_output``.

    Raises:
        OSError: it cannot be written or is a link.
    """
    with open_output(path) as stream:
        stream.write(data)


@contextmanager
def utf8_name(path: Path) -> Iterator[str]:
    """Yield a UTF-8 name for a file, as OpenCV aborts the process on any other.

    Raises:
        OSError: no such name exists, as the temporary folder's name is not UTF-8 either.
    """
    if _is_utf8(path):
        yield str(path)
        return
    with TemporaryDirectory() as folder:
        link = Path(folder) / f"file{path.suffix if _is_utf8(Path(path.suffix)) else ''}"
        if not _is_utf8(link):
            raise OSError(errno.EILSEQ, "a file name that is not UTF-8", str(path))
        link.symlink_to(path.resolve())
        yield str(link)


def _is_utf8(path: Path) -> bool:
    try:
        str(path).encode()
    except UnicodeEncodeError:
        return False
    return True


def _writable(path: Path, flags: int) -> int:
    try:
        return _opened(path, flags | os.O_NOFOLLOW)
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise OSError(errno.ELOOP, "a symbolic link, not a regular file", str(path)) from error
        raise


def _opened(path: Path, flags: int) -> int:
    """Return the descriptor of a regular file, opened without blocking."""
    try:
        descriptor = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
    except ValueError:  # null byte, possible where the name comes from a file
        raise OSError(errno.EINVAL, "an invalid file name", repr(str(path))) from None
    try:
        _check_regular(path, os.fstat(descriptor).st_mode)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def _check_regular(path: Path, mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        kind = _KINDS.get(stat.S_IFMT(mode), "a special file")
        raise OSError(errno.EINVAL, f"{kind}, not a regular file", str(path))
