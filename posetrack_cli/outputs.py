"""Names, checks and atomic replacement of output files."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.files import open_existing


def part_path(path: Path) -> Path:
    """Return the name of a file while it is being written: NAME.part."""
    return path.with_name(path.name + ".part")


def state_path(path: Path) -> Path:
    """Return the checkpoint name of an interrupted run: NAME.part.state."""
    return path.with_name(path.name + ".part.state")


def check_output(
    out: Path, *, overwrite: bool, source: Path | None = None, source_name: str = "recording"
) -> None:
    """Check that an MCAP output can be written and replaces nothing it must not.

    Raises:
        UsageError: the name does not end in ``.mcap``; otherwise see ``check_target``.
        ResultError: see ``check_target``.
    """
    if out.suffix != ".mcap":
        raise UsageError("output is not an MCAP file", where=out, expected="a name ending in .mcap")
    check_target(out, overwrite=overwrite, source=source, source_name=source_name)


def check_target(
    out: Path, *, overwrite: bool, source: Path | None = None, source_name: str = "recording"
) -> None:
    """Check that an output of any kind can be written and replaces nothing it must not.

    Raises:
        UsageError: it is a folder or a device, would overwrite the source (under its own name or as
            NAME.part) or write through a link, or exists (as file or interrupted run) without
            ``overwrite``.
        ResultError: its folder does not exist.
    """
    check_place(out)
    for written in (out, part_path(out)):
        if source is not None and source.exists() and written.exists() and written.samefile(source):
            raise UsageError(
                f"output would replace the {source_name}", where=written, hint="choose another name"
            )
        if written.is_dir():
            raise UsageError("output is a folder", where=written, expected="a file name")
        if written.exists() and not written.is_file():  # renaming would replace even /dev/null
            raise UsageError("output is not a regular file", where=written, expected="a file name")
    if not overwrite:
        check_free(out)


def check_place(out: Path) -> None:
    """Check that a file can be written at this path.

    Raises:
        UsageError: NAME.part, NAME.part.state or the like is a symbolic link. Another user may have placed it
            there to have its target overwritten.
        ResultError: the folder does not exist.
    """
    try:
        links = [
            entry
            for entry in os.scandir(out.parent)
            if entry.name.startswith(part_path(out).name) and entry.is_symlink()
        ]
    except (FileNotFoundError, NotADirectoryError) as error:
        raise ResultError("cannot be written", where=out, found=f"no folder {out.parent}") from error
    except PermissionError:
        return  # writable but not listable folder; open_output still refuses links
    if links:
        raise link_refused(Path(links[0].path))


def link_refused(path: Path) -> UsageError:
    """Return the error for a symbolic link in place of an output."""
    return UsageError(
        "is a symbolic link; refusing to write through it",
        where=path,
        hint="delete it or choose another output",
    )


def make_folder(folder: Path, root: Path) -> None:
    """Create a folder below ``root``, including intermediate folders.

    Raises:
        UsageError: one of them is a symbolic link, which could lead elsewhere.
        OSError: it cannot be created or is a file.
    """
    for one in reversed([folder, *folder.parents][: len(folder.relative_to(root).parts)]):
        if one.is_symlink():
            raise link_refused(one)
        one.mkdir(exist_ok=True)


def check_free(out: Path) -> None:
    """Raise UsageError if the output exists as a file or as a run that can be resumed."""
    if is_taken(out):
        raise UsageError("already exists", where=out, hint="use --overwrite to replace it")
    if state_path(out).exists():
        raise UsageError(
            "belongs to an interrupted run",
            where=part_path(out),
            hint="use --resume to continue it or --overwrite to replace it",
        )


def is_taken(path: Path) -> bool:
    """Return whether the name is in use, even by a dangling symbolic link, which would be replaced."""
    return os.path.lexists(path)


def lock(stream: IO[bytes]) -> bool:
    """Lock an open file as being written, until it is closed or its process ends.

    The operating system ties the lock to the open file, so a crash leaves none behind. It also holds between
    machines on a shared file system that supports locks, as NFS does by default.

    Returns:
        False if another process holds the lock. True on file systems without locks.
    """
    from filelock import lock_descriptor

    with suppress(OSError):  # some file systems have no locks
        for _ in range(_ATTEMPTS):
            if lock_descriptor(stream.fileno(), blocking=False):
                return True
            time.sleep(_PAUSE_S)
        return False
    return True


_ATTEMPTS, _PAUSE_S = 4, 0.02
"""Retries cover ``check_not_written``, which holds the lock for an instant."""


def check_not_written(path: Path) -> None:
    """Raise UsageError if another process is writing the file."""
    try:
        with open_existing(path) as stream:  # NFS grants exclusive locks only on writable descriptors
            if lock(stream):
                return
    except OSError:
        return  # missing or not writable
    raise UsageError(
        "is being written by another process", where=path, hint="wait for it, or choose another output"
    )


@contextmanager
def whole_or_nothing(out: Path) -> Iterator[Path]:
    """Yield NAME.part for writing; rename it to ``out`` on success, delete it on failure or Ctrl-C.

    If ``out`` is a symbolic link, the link is replaced, not its target.

    Raises:
        UsageError: another process is writing it, or NAME.part is a symbolic link.
        ResultError: it cannot be written or renamed.
    """
    part = part_path(out)
    check_place(out)
    check_not_written(part)  # before the try, as its part file must survive the error
    try:
        yield part
        part.replace(out)
    except OSError as error:
        _delete(part)
        raise ResultError("cannot be written", where=out, found=error.strerror or error) from error
    except BaseException:
        _delete(part)
        raise


def _delete(part: Path) -> None:
    with suppress(OSError):
        part.unlink(missing_ok=True)
