"""Export of a track's table as Apache Parquet: the columns of CSV with types, units and meanings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from posetrack_cli.errors import UsageError
from posetrack_cli.files import open_output
from posetrack_cli.results.columns import Columns
from posetrack_cli.results.export.source import ExportSource, header_values
from posetrack_cli.text import printable, printable_json

HEADER = "posetrack"
"""Metadata key of the header, JSON text as in ``json_text``."""


def write_parquet(source: ExportSource, path: Path) -> None:
    """Write one row per frame, a thousand frames per row group.

    Frame numbers and stamps are integers, ``resampled`` is boolean, ``status`` a dictionary of text, and
    everything else double, null where unknown. Columns have the metadata ``unit`` and ``meaning``.

    Raises:
        UsageError: pyarrow is not installed.
        ResultError: see ``ExportSource.blocks``.
    """
    try:
        import pyarrow as arrow  # optional dependency, extra "parquet"
        from pyarrow.parquet import ParquetWriter
    except ImportError as error:
        raise UsageError("parquet needs pyarrow", hint="pip install 'posetrack[parquet]'") from error
    groups = source.table
    blocks = source.begun_blocks()

    def arrays(block: Columns) -> list[Any]:
        columns = (values for group in groups for values in group.values(block).T)
        return [
            arrow.array(values.tolist(), arrow.string()).dictionary_encode()
            if values.dtype.kind == "U"
            else arrow.array(values, from_pandas=True)  # NaN becomes null
            for values in columns
        ]

    about = [
        (printable(name), {"unit": group.unit, "meaning": group.meaning})
        for group in groups
        for name in group.names
    ]
    typed = zip(about, arrays(source.empty_columns()), strict=True)
    header = json.dumps(header_values(source), ensure_ascii=False)
    schema = arrow.schema(
        [arrow.field(name, array.type, metadata=metadata) for (name, metadata), array in typed],
        metadata={HEADER: printable_json(header)},
    )
    with open_output(path) as stream, ParquetWriter(stream, schema) as writer:
        for block in blocks:
            writer.write_table(arrow.Table.from_arrays(arrays(block), schema=schema))
