"""Names and replacement of the files that posetrack writes."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.files import open_input


def part_path(path: Path) -> Path:
    """Return the name of a file while it is written: NAME.part."""
    return path.with_name(path.name + ".part")


def state_path(path: Path) -> Path:
    """Return the name of the checkpoint of an interrupted run's result: NAME.part.state."""
    return path.with_name(path.name + ".part.state")


def check_output(out: Path, *, overwrite: bool, source: Path | None = None) -> None:
    """Refuse an MCAP output that cannot be written under this name, or would replace what it must not.

    Raises:
        UsageError: it is not named ``*.mcap``; and as of ``check_target``.
        ResultError: as of ``check_target``.
    """
    if out.suffix != ".mcap":
        raise UsageError(
            "output is not named as an MCAP file", where=out, expected="a name that ends in .mcap"
        )
    check_target(out, overwrite=overwrite, source=source)


def check_target(
    out: Path, *, overwrite: bool, source: Path | None = None, source_name: str = "recording"
) -> None:
    """Refuse an output of any kind that cannot be written, or would replace what it must not.

    Raises:
        UsageError: it is a folder or a device, would be written over the source (under its own name or as
            NAME.part), or a file or an interrupted run is there that may not be replaced.
        ResultError: its folder does not exist.
    """
    check_folder(out)
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


def check_folder(out: Path) -> None:
    """Raise ResultError unless the folder that a file is to be written to exists."""
    if not out.parent.is_dir():
        raise ResultError("cannot be written", where=out, found=f"no folder {out.parent}")


def check_free(out: Path) -> None:
    """Raise UsageError if writing here would replace a file or a run that can be resumed."""
    if out.exists():
        raise UsageError("exists already", where=out, hint="use --overwrite to replace it")
    if state_path(out).exists():
        raise UsageError(
            "is of an interrupted run",
            where=part_path(out),
            hint="use --resume to go on with it or --overwrite to replace it",
        )


def lock(stream: IO[bytes]) -> None:
    """Mark an open file as being written, until it is closed or its process ends, killed or not."""
    with suppress(OSError):  # there are file systems without locks
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)


def check_not_written(path: Path) -> None:
    """Raise UsageError if a file is being written by another process."""
    try:
        with open_input(path) as stream:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise UsageError(
            "is being written by another process", where=path, hint="wait for it, or choose another output"
        ) from error
    except OSError:
        return  # no such file, or none that could be locked


@contextmanager
def whole_or_nothing(out: Path) -> Iterator[Path]:
    """Yield NAME.part to write to; renamed to ``out`` at the end, deleted after any failure or Ctrl-C.

    Raises:
        UsageError: another process is writing it.
        ResultError: it cannot be renamed.
    """
    part = part_path(out)
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
