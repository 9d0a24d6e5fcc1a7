"""Names and replacement of the files that posetrack writes."""

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
    """Return the name of a file while it is written: NAME.part."""
    return path.with_name(path.name + ".part")


def state_path(path: Path) -> Path:
    """Return the name of the checkpoint of an interrupted run's result: NAME.part.state."""
    return path.with_name(path.name + ".part.state")


def check_output(
    out: Path, *, overwrite: bool, source: Path | None = None, source_name: str = "recording"
) -> None:
    """Refuse an MCAP output that cannot be written under this name, or would replace what it must not.

    Raises:
        UsageError: it is not named ``*.mcap``; and as of ``check_target``.
        ResultError: as of ``check_target``.
    """
    if out.suffix != ".mcap":
        raise UsageError(
            "output is not named as an MCAP file", where=out, expected="a name that ends in .mcap"
        )
    check_target(out, overwrite=overwrite, source=source, source_name=source_name)


def check_target(
    out: Path, *, overwrite: bool, source: Path | None = None, source_name: str = "recording"
) -> None:
    """Refuse an output of any kind that cannot be written, or would replace what it must not.

    Raises:
        UsageError: it is a folder or a device, would be written over the source (under its own name or as
            NAME.part) or through a link, or a file or an interrupted run is there that may not be replaced.
        ResultError: its folder does not exist.
    """
    check_place(out)
    for written in (out, part_path(out)):
        if source is not None and source.exists() and written.exists() and written.samefile(source):
            raise UsageError(
                f"output would replace the {source_name}", where=written, hint="choose another name"
            )
        if written.is_dir():
            raise UsageError("output is a folder", where=written, expected="the name of a file")
        if written.exists() and not written.is_file():  # it would be replaced, /dev/null too
            raise UsageError("output is no plain file", where=written, expected="the name of a file")
    if not overwrite:
        check_free(out)


def check_place(out: Path) -> None:
    """Refuse a place that a file cannot be written to.

    Raises:
        UsageError: a symbolic link has a name that is written to before the file gets its own: NAME.part,
            NAME.part.state and the like. Somebody else may have put it there, for its target to be replaced.
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
        return  # a folder may be written to and not be listed; what is opened is no link all the same
    if links:
        raise link_refused(Path(links[0].path))


def link_refused(path: Path) -> UsageError:
    """The error of a symbolic link that would be written through."""
    return UsageError(
        "is a symbolic link, and nothing is written through it",
        where=path,
        hint="delete it or choose another output",
    )


def make_folder(folder: Path, root: Path) -> None:
    """Make a folder below another one, with those between them.

    Raises:
        UsageError: one of them is a symbolic link: what is written would lie elsewhere.
        OSError: it cannot be made, or is a file.
    """
    for one in reversed([folder, *folder.parents][: len(folder.relative_to(root).parts)]):
        if one.is_symlink():
            raise link_refused(one)
        one.mkdir(exist_ok=True)


def check_free(out: Path) -> None:
    """Raise UsageError if writing here would replace a file or a run that can be resumed."""
    if is_taken(out):
        raise UsageError("exists already", where=out, hint="use --overwrite to replace it")
    if state_path(out).exists():
        raise UsageError(
            "is of an interrupted run",
            where=part_path(out),
            hint="use --resume to go on with it or --overwrite to replace it",
        )


def is_taken(path: Path) -> bool:
    """Whether there is a file of this name, be it a symbolic link to nothing: the link would be replaced."""
    return os.path.lexists(path)


def lock(stream: IO[bytes]) -> bool:
    """Mark an open file as being written, until it is closed or its process ends, killed or not.

    The operating system keeps the lock with the open file, so a crash leaves none behind. It also holds
    between machines that share a file system, if that passes locks on, as NFS does by default.

    Returns:
        False if another process has it locked. Where there are no locks the answer is True, and nobody is
        kept out.
    """
    from filelock import lock_descriptor

    with suppress(OSError):  # there are file systems without locks
        for _ in range(_ATTEMPTS):
            if lock_descriptor(stream.fileno(), blocking=False):
                return True
            time.sleep(_PAUSE_S)
        return False
    return True


_ATTEMPTS, _PAUSE_S = 4, 0.02
"""Who only asks whether a file is locked holds its lock for an instant, and keeps nobody out."""


def check_not_written(path: Path) -> None:
    """Raise UsageError if a file is being written by another process."""
    try:
        with open_existing(path) as stream:  # to be written to: NFS locks nothing else for one process alone
            if lock(stream):
                return
    except OSError:
        return  # no such file, or none that could be written to
    raise UsageError(
        "is being written by another process", where=path, hint="wait for it, or choose another output"
    )


@contextmanager
def whole_or_nothing(out: Path) -> Iterator[Path]:
    """Yield NAME.part to write to; renamed to ``out`` at the end, deleted after any failure or Ctrl-C.

    Where ``out`` is a symbolic link, the link is replaced, and its target stays.

    Raises:
        UsageError: another process is writing it, or it is a symbolic link.
        ResultError: it cannot be renamed.
    """
    part = part_path(out)
    check_place(out)
    check_not_written(part)  # and leave it alone
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
