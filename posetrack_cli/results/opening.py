"""Open a result's file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from posetrack_cli.errors import ResultError
from posetrack_cli.files import open_input
from posetrack_cli.mcap.records import MAGIC


@contextmanager
def opened(path: Path) -> Iterator[IO[bytes]]:
    """Open an MCAP file; whatever the operating system refuses while it is read is one line.

    Raises:
        ResultError: the file cannot be read, or is no MCAP file.
    """
    try:
        with open_input(path) as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise ResultError("is no MCAP file", where=path, hint="results are .mcap files")
            yield stream
    except OSError as error:
        raise ResultError("cannot be read", where=path, found=error.strerror or error) from error
