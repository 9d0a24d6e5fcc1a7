"""Names and replacement of the files that posetrack writes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from posetrack_cli.errors import ResultError, UsageError


def part_path(path: Path) -> Path:
    """Return the name of a file while it is written: NAME.part."""
    return path.with_name(path.name + ".part")


def check_output(out: Path, *, overwrite: bool, source: Path | None = None) -> None:
    """Refuse an output that is not named ``*.mcap``, is the source itself, or may not be replaced.

    Raises:
        UsageError: says which.
    """
    if out.suffix != ".mcap":
        raise UsageError(
            "output is not named as an MCAP file", where=out, expected="a name that ends in .mcap"
        )
    if not out.exists():
        return
    if source is not None and out.samefile(source):
        raise UsageError("output is the recording itself", where=out)
    if not overwrite:
        raise UsageError("exists already", where=out, hint="pass --overwrite to replace it")


@contextmanager
def whole_or_nothing(out: Path) -> Iterator[Path]:
    """Yield NAME.part to write to; renamed to ``out`` at the end, deleted after any failure or Ctrl-C.

    Raises:
        ResultError: it cannot be renamed.
    """
    part = part_path(out)
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
