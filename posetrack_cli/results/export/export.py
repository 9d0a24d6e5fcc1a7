"""Export a result: text in any of its formats, or arrays for numpy."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import IO

import numpy as np

from posetrack_cli.errors import UsageError
from posetrack_cli.files import open_output
from posetrack_cli.outputs import check_target, whole_or_nothing
from posetrack_cli.results.export.source import ExportSource, header_values
from posetrack_cli.results.export.text_formats import csv_text, json_text, tum_text
from posetrack_cli.results.fields import BY_NAME
from posetrack_cli.results.subject_kind import kind_of

TEXT_FORMATS: Mapping[str, Callable[[ExportSource], Iterator[str]]] = {
    "csv": csv_text,
    "tum": tum_text,
    "json": json_text,
}
NPZ = "npz"
FORMATS = (*TEXT_FORMATS, NPZ)
ROLL_PITCH_YAW = "roll_pitch_yaw_deg"


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


def write_npz(source: ExportSource, path: Path) -> None:
    """Write every field of the estimates as one array, frames first.

    Beside them: ``roll_pitch_yaw_deg`` (N, 3), ``shape_names``, ``point_names``, ``number_names`` where there
    are further numbers, and ``header``, a JSON text that states units, Euler order and the run record.
    """
    columns = source.columns()
    subject = source.result.subject
    header = {key: value for key, value in header_values(source).items() if key != "meanings"}
    header["units"] = _units(source.result.field_names)  # of arrays
    extras = {
        ROLL_PITCH_YAW: np.degrees(kind_of(subject.name).euler_angles(columns["quaternion"])),
        "shape_names": np.array(subject.shape_names, dtype=np.str_),
        "point_names": np.array(subject.point_names, dtype=np.str_),
        "header": np.array(json.dumps(header, ensure_ascii=False)),
    }
    if subject.number_names:
        extras["number_names"] = np.array(subject.number_names, dtype=np.str_)
    with open_output(path) as stream:
        np.savez(stream, **columns, **extras)  # type: ignore[arg-type]


def _units(fields: Iterable[str]) -> dict[str, str]:
    """Of the arrays that have one, the Euler angles behind the quaternions that they are made from."""
    units = {}
    for name in fields:
        if BY_NAME[name].unit:
            units[name] = BY_NAME[name].unit
        if name == "quaternion":
            units[ROLL_PITCH_YAW] = "deg"
    return units
