"""How files are opened: only regular ones are read, and no symbolic link is written through.

A named pipe or a device in the place of a recording would never end; a link in the place of a file that is
being written would have its target overwritten. What is refused raises ``OSError`` with a reason in its
``strerror``, which callers tell as they tell that a file is missing.
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
    """Open a regular file to read its bytes; of anything else nothing is read, and nothing is waited for.

    Raises:
        OSError: it cannot be opened, or is no regular file.
    """
    return os.fdopen(_opened(path, os.O_RDONLY), "rb")


def begins_with(path: Path, magic: bytes) -> bool:
    """Whether the first bytes of a regular file are these, by which formats are told.

    Raises:
        OSError: it cannot be read, or is no regular file.
    """
    with open_input(path) as stream:
        return stream.read(len(magic)) == magic


def read_input(path: Path, most: int) -> bytes:
    """Return the bytes of a regular file.

    Args:
        path: the file.
        most: bytes; see ``limits``.

    Raises:
        OSError: it cannot be read, is no regular file, or larger.
    """
    with open_input(path) as stream:
        size = os.fstat(stream.fileno()).st_size
        data = stream.read(min(size, most) + 1)  # room for so much is made at once
    if len(data) > most:
        raise OSError(errno.EFBIG, f"a file of {size} bytes, at most {most} are read", str(path))
    return data


def read_text(path: Path, most: int, encoding: str = "utf-8") -> str:
    """Return the text of a regular file.

    Raises:
        OSError: as of ``read_input``.
        UnicodeDecodeError: it is in another encoding.
    """
    return read_input(path, most).decode(encoding)


def real_path(path: Path) -> Path:
    """Return where a path leads; where links form a ring ``Path.resolve`` would raise RuntimeError."""
    return Path(os.path.realpath(path))


def hint_of_missing(path: Path, of_pattern: str) -> str:
    """Return what to do about a name that no file has, but that looks like something else.

    Args:
        path: as it was typed.
        of_pattern: what to do if it is a pattern that no shell has filled in.
    """
    if re.match(r"[A-Za-z][A-Za-z0-9+.-]+:/", str(path)):  # pathlib has made one slash of two
        return "addresses are not read: download it first"
    return of_pattern if any(sign in str(path) for sign in "*?[") else ""


def placed_path(path: Path) -> Path:
    """Return the absolute path of what a user names: a link stays one, as what it leads to has another name.

    Version control of data (DVC, git-annex) keeps recordings in a store, and links to them where they belong.
    """
    return Path(os.path.abspath(path))  # noqa: PTH100 Path.resolve would follow the link


def open_output(path: Path) -> BufferedWriter:
    """Open a file to write it anew; a symbolic link in its place is refused.

    Raises:
        OSError: it cannot be opened, or is a link.
    """
    return os.fdopen(_writable(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), "wb")


def open_existing(path: Path) -> BufferedRandom:
    """Open a file that is there to read it and to write more; a symbolic link in its place is refused.

    Raises:
        OSError: it cannot be opened, is a link, or no regular file.
    """
    return os.fdopen(_writable(path, os.O_RDWR), "r+b")


def write_output(path: Path, data: bytes) -> None:
    """Write a file anew as ``open_output`` opens it.

    Raises:
        OSError: it cannot be written, or is a link.
    """
    with open_output(path) as stream:
        stream.write(data)


@contextmanager
def utf8_name(path: Path) -> Iterator[str]:
    """Yield a name for OpenCV to open a file by: one that is not UTF-8 ends the process in OpenCV.

    Raises:
        OSError: there is none, as temporary files lie in a folder whose name is not UTF-8 either.
    """
    if _is_utf8(path):
        yield str(path)
        return
    with TemporaryDirectory() as folder:
        link = Path(folder) / f"file{path.suffix if _is_utf8(Path(path.suffix)) else ''}"
        if not _is_utf8(link):
            raise OSError(errno.EILSEQ, "a name that is not UTF-8", str(path))
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
            raise OSError(errno.ELOOP, "a symbolic link, which is not written through", str(path)) from error
        raise


def _opened(path: Path, flags: int) -> int:
    """Return the descriptor of a regular file, opened without waiting for anything."""
    try:
        descriptor = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
    except ValueError:  # a null byte, which a name from a file may hold
        raise OSError(errno.EINVAL, "no name that a file can have", repr(str(path))) from None
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
