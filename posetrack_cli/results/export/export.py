"""Export a result."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import IO

from posetrack_cli.errors import UsageError
from posetrack_cli.files import open_output
from posetrack_cli.outputs import check_target, whole_or_nothing
from posetrack_cli.results.export.npz_format import write_npz
from posetrack_cli.results.export.source import ExportSource
from posetrack_cli.results.export.text_formats import csv_text, json_text, tum_text

TEXT_FORMATS: Mapping[str, Callable[[ExportSource], Iterator[str]]] = {
    "csv": csv_text,
    "tum": tum_text,
    "json": json_text,
}
NPZ = "npz"
FORMATS = (*TEXT_FORMATS, NPZ)


def export_file(source: ExportSource, format_name: str, out: Path, *, overwrite: bool = False) -> None:
    """Write a file in one of ``FORMATS``, whole or not at all.

    Raises:
        UsageError: ``out`` is a folder, the result itself, or exists and may not be replaced.
        ResultError: it cannot be written, or the result not be read.
    """
    check_target(out, overwrite=overwrite, source=source.result.path, source_name="result")
    with whole_or_nothing(out) as part:
        if format_name == NPZ:
            write_npz(source, part)
            return
        with open_output(part) as stream:
            export_text(source, format_name, stream)


def export_text(source: ExportSource, format_name: str, stream: IO[bytes]) -> None:
    """Write one of ``TEXT_FORMATS`` to an open stream, as UTF-8; see ``text_pieces``."""
    for piece in text_pieces(source, format_name):
        stream.write(piece.encode("utf-8", "backslashreplace"))


def text_pieces(source: ExportSource, format_name: str) -> Iterator[str]:
    """Yield one of ``TEXT_FORMATS``, piece by piece.

    Raises:
        UsageError: it is no text format.
        ResultError: the result cannot be read.
    """
    if format_name not in TEXT_FORMATS:
        raise UsageError(
            f"{format_name} is no text", expected=", ".join(TEXT_FORMATS), hint="name a file with -o"
        )
    yield from TEXT_FORMATS[format_name](source)
