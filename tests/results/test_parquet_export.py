"""Parquet tables, read by pandas and by pyarrow."""

from __future__ import annotations

import builtins
import json
from pathlib import Path
from typing import Any

import pytest

from posetrack_cli.errors import UsageError
from posetrack_cli.results import Result, read_result
from posetrack_cli.results.export.export import export_file
from posetrack_cli.results.export.source import export_source, header_values
from support.hand_results import hand, write
from support.results import write_result

FRAMES = 1010  # more than a block


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Result:
    return read_result(write_result(tmp_path_factory.mktemp("result") / "r.mcap", FRAMES))


def test_pandas_reads_the_table_that_to_pandas_gives(result: Result, tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow", reason="pyarrow, of the extra parquet, is not installed")
    of_hand = read_result(write(tmp_path / "h.mcap", hand("right"), inner=True, lost=(3,)))
    for one in (result, of_hand):
        out = tmp_path / f"{one.path.stem}.parquet"
        export_file(export_source(one), "parquet", out)
        found, expected = pandas.read_parquet(out), one.to_pandas()
        known = expected["status"].cat.categories  # in alphabetic order; those of the file as they come
        assert set(found["status"].cat.categories) == set(known)
        found["status"] = found["status"].cat.set_categories(known)
        found = found.set_index("stamp_ns")[expected.columns]
        pandas.testing.assert_frame_equal(found, expected, check_exact=True)


def test_columns_have_types_units_and_meanings(result: Result, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow, of the extra parquet, is not installed")
    from pyarrow import parquet

    export_file(export_source(result), "parquet", tmp_path / "r.parquet")
    schema, source = parquet.read_schema(tmp_path / "r.parquet"), export_source(result)
    types = {"frame_index": "int64", "stamp_ns": "int64", "resampled": "bool"}
    for group in source.table:
        for name in group.names:
            field = schema.field(name)
            assert {key.decode(): text.decode() for key, text in field.metadata.items()} == {
                "unit": group.unit,
                "meaning": group.meaning,
            }
            if name != "status":
                assert str(field.type) == types.get(name, "double"), name
    assert json.loads(schema.metadata[b"posetrack"]) == json.loads(json.dumps(header_values(source)))
    assert parquet.ParquetFile(tmp_path / "r.parquet").metadata.num_rows == FRAMES


def test_without_pyarrow_the_extra_is_named(
    result: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = builtins.__import__

    def missing(name: str, *rest: Any) -> Any:
        if name.partition(".")[0] == "pyarrow":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(UsageError, match=r"parquet needs pyarrow; pip install 'posetrack\[parquet\]'"):
        export_file(export_source(result), "parquet", tmp_path / "r.parquet")
    assert list(tmp_path.iterdir()) == []
