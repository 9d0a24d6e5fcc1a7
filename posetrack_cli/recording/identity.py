"""What identifies an input: sizes and SHA-256 of its bytes."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable
from pathlib import Path

from posetrack_cli.errors import RecordingError
from posetrack_cli.files import open_input

READ_BYTES = 1024 * 1024


def file_digest(path: Path) -> tuple[int, str]:
    """Return a file's size and the SHA-256 of its bytes, read in pieces."""
    digest = hashlib.sha256()
    return _feed(digest, path), digest.hexdigest()


def files_digest(files: Iterable[tuple[str, Path]]) -> tuple[int, str]:
    """Return the total size and one SHA-256 over names, sizes and contents of files, in the given order.

    Args:
        files: pairs of the name that enters the hash and the path to read.
    """
    digest = hashlib.sha256()
    total = 0
    for name, path in files:
        # Sizes are hashed so that bytes cannot move from one file to the next unnoticed.
        digest.update(os.fsencode(name) + f"\0{_size(path)}\0".encode())
        total += _feed(digest, path)
    return total, digest.hexdigest()


def identity_record(path: Path, kind: str, digested: tuple[int, str]) -> dict[str, str]:
    """Return name, kind, size and SHA-256 of a recording for run records.

    Args:
        path: the file or folder.
        kind: ``mcap``, ``video`` or ``folder``.
        digested: size and SHA-256, of ``file_digest`` or ``files_digest``.
    """
    size, digest = digested
    return {"name": shown_name(path.resolve()), "kind": kind, "bytes": str(size), "sha256": digest}


def shown_name(path: Path) -> str:
    """Return the name of a file or folder as text that every file can hold, whatever its bytes are."""
    return os.fsencode(path.name).decode(errors="replace")


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError as error:
        raise RecordingError("cannot be read", where=path, found=error.strerror or error) from error


def _feed(digest: hashlib._Hash, path: Path) -> int:
    size = 0
    try:
        with open_input(path) as stream:
            while piece := stream.read(READ_BYTES):
                digest.update(piece)
                size += len(piece)
    except OSError as error:
        raise RecordingError("cannot be read", where=path, found=error.strerror or error) from error
    return size
