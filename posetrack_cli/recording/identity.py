"""Identity of an input: size and SHA-256 of its bytes."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from posetrack_cli.errors import RecordingError
from posetrack_cli.files import open_input, placed_path
from posetrack_cli.phases import Advance, phase

READ_BYTES = 1024 * 1024
# Takes more than a second or two to read, so it reports progress.
LONG_BYTES = 512 * READ_BYTES
_SILENT: AbstractContextManager[Advance] = nullcontext(lambda count: None)
Digests = dict[str, tuple[int, str]]  # size and SHA-256 by ``files_state``
_known: Digests = {}
_MOST_KNOWN = 10_000


def known_digests() -> Digests:
    """Return the digests that this process has computed or received."""
    return dict(_known)


def tell_digests(digests: Mapping[str, tuple[int, str]]) -> None:
    """Add digests computed by another process, so that pieces of one long recording hash it once."""
    _known.update({state: (size, digest) for state, (size, digest) in digests.items()})


def file_digest(path: Path) -> tuple[int, str]:
    """Return a file's size and the SHA-256 of its bytes, read in pieces."""

    def compute(advance: Advance) -> tuple[int, str]:
        digest = hashlib.sha256()
        return _feed(digest, path, advance), digest.hexdigest()

    return _once([("", path)], compute)


def files_digest(files: Iterable[tuple[str, Path]]) -> tuple[int, str]:
    """Return the total size and one SHA-256 over names, sizes and contents of files, in order.

    Args:
        files: pairs of the hashed name and the path to read.
    """
    files = list(files)

    def compute(advance: Advance) -> tuple[int, str]:
        digest, total = hashlib.sha256(), 0
        for name, path in files:
            # Hash sizes too, or moving bytes from one file to the next would go unnoticed.
            digest.update(os.fsencode(name) + f"\0{_stat(path).st_size}\0".encode())
            total += _feed(digest, path, advance)
        return total, digest.hexdigest()

    return _once(files, compute)


def files_state(files: Sequence[tuple[str, Path]]) -> str:
    """Return a fingerprint of files without reading them: names, sizes, modification times.

    Args:
        files: pairs of the hashed name and the path.

    Raises:
        RecordingError: a file does not exist.
    """
    state = hashlib.sha256()
    for name, path in files:
        stat = _stat(path)
        state.update(os.fsencode(name) + b"\0" + os.fsencode(path.absolute()))
        state.update(f"\0{stat.st_size}\0{stat.st_mtime_ns}\0".encode())
    return f"{len(files)}-{state.hexdigest()}"


def _once(
    files: Sequence[tuple[str, Path]], compute: Callable[[Advance], tuple[int, str]]
) -> tuple[int, str]:
    """Return the digest of the files in their present state, from the cache if possible."""
    state = files_state(files)
    if state not in _known:
        if len(_known) >= _MOST_KNOWN:
            _known.clear()
        size = sum(_stat(path).st_size for _, path in files)
        shown = phase("reading for the SHA-256", "MiB", size // READ_BYTES) if size >= LONG_BYTES else _SILENT
        with shown as advance:
            _known[state] = compute(advance)
    return _known[state]


def identity_record(path: Path, kind: str, digested: tuple[int, str]) -> dict[str, str]:
    """Return name, kind, size and SHA-256 of a recording for run records.

    Args:
        path: the file or folder.
        kind: ``video``, ``folder``, or the kind of a message container.
        digested: size and SHA-256 from ``file_digest`` or ``files_digest``.
    """
    size, digest = digested
    return {"name": shown_name(placed_path(path)), "kind": kind, "bytes": str(size), "sha256": digest}


def shown_name(path: Path) -> str:
    """Return the name of a file or folder, decoded like ``shown_path``."""
    return shown_path(Path(path.name))


def shown_path(path: Path) -> str:
    """Return a path as valid text, with undecodable bytes replaced."""
    return os.fsencode(path).decode(errors="replace")


def _stat(path: Path) -> os.stat_result:
    try:
        return path.stat()
    except OSError as error:
        raise RecordingError("cannot be read", where=path, found=error.strerror or error) from error


def _feed(digest: hashlib._Hash, path: Path, advance: Advance) -> int:
    size = 0
    try:
        with open_input(path) as stream:
            while piece := stream.read(READ_BYTES):
                digest.update(piece)
                size += len(piece)
                advance(1)
    except OSError as error:
        raise RecordingError("cannot be read", where=path, found=error.strerror or error) from error
    return size
