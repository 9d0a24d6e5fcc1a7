"""The spool of records: back in reverse, also after an interruption, and its errors in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.errors import ResultError
from posetrack_cli.results import spool as module
from posetrack_cli.results.spool import RecordSpool


def record(number: int) -> dict[str, np.ndarray]:
    stamp = np.asarray(1_700_000_000_000_000_000 + number)  # no float64 has its last digits
    return {"stamp_ns": stamp, "matrix": np.full((2, 3), number / 7.0), "scalar": np.asarray(0.1 * number)}


def assert_holds(records, numbers: list[int]) -> None:
    found = list(records)
    assert len(found) == len(numbers)
    for values, number in zip(found, numbers, strict=True):
        for name, expected in record(number).items():
            np.testing.assert_array_equal(values[name], expected)
            assert values[name].dtype == expected.dtype


def filled(path: Path, count: int, keep: int = 0) -> RecordSpool:
    spool = RecordSpool(path, keep, record(0))
    for number in range(keep, count):
        spool.append(record(number))
    return spool


@pytest.mark.parametrize("block", [1, 200, 1 << 22])  # bytes: one record, some, all of them at once
@pytest.mark.parametrize("count", [0, 1, 10])
def test_records_come_back_in_reverse(tmp_path: Path, monkeypatch, block: int, count: int) -> None:
    monkeypatch.setattr(module, "BLOCK_BYTES", block)
    with filled(tmp_path / "spool", count) as spool:
        assert len(spool) == count
        assert_holds(reversed(spool), list(range(count))[::-1])
        assert_holds(reversed(spool), list(range(count))[::-1])


def test_values_keep_their_types(tmp_path: Path) -> None:
    """An image of single precision takes half the room of doubles."""
    values = {"image": np.arange(6, dtype=np.float32).reshape(2, 3), "few": np.asarray(-7, dtype=np.int16)}
    with RecordSpool(tmp_path / "spool") as spool:
        spool.append(values)
        spool.append(values)
        back = next(reversed(spool))
    for name, expected in values.items():
        np.testing.assert_array_equal(back[name], expected)
        assert back[name].dtype == expected.dtype
    header = (tmp_path / "spool").read_bytes().index(b"\n") + 1
    assert (tmp_path / "spool").stat().st_size == header + 2 * (6 * 4 + 2 + module.DIGEST_BYTES)


def test_reading_does_not_disturb_writing(tmp_path: Path) -> None:
    with filled(tmp_path / "spool", 3) as spool:
        next(reversed(spool))
        spool.append(record(3))
        assert_holds(reversed(spool), [3, 2, 1, 0])


def test_an_interrupted_run_keeps_what_its_checkpoint_counted(tmp_path: Path) -> None:
    """Five were written and three are counted; half a record lies behind them."""
    path = tmp_path / "spool"
    filled(path, 5).close()
    with path.open("ab") as file:
        file.write(b"torn")
    with filled(path, 6, keep=3) as spool:
        assert_holds(reversed(spool), [5, 4, 3, 2, 1, 0])
    assert path.read_bytes() == (filled(tmp_path / "whole", 6).close(), (tmp_path / "whole").read_bytes())[1]


def test_nothing_to_keep_starts_anew(tmp_path: Path) -> None:
    filled(tmp_path / "spool", 5).close()
    with filled(tmp_path / "spool", 2) as spool:
        assert_holds(reversed(spool), [1, 0])


def test_flushed_records_are_on_the_disk(tmp_path: Path) -> None:
    path = tmp_path / "spool"
    with filled(path, 3) as spool:
        spool.flush()
        with RecordSpool(path, 3, record(0)) as other:
            assert_holds(reversed(other), [2, 1, 0])


def test_deleted_is_gone(tmp_path: Path) -> None:
    spool = filled(tmp_path / "spool", 2)
    spool.delete()
    assert not (tmp_path / "spool").exists()


def test_memory_does_not_grow_with_the_file(tmp_path: Path) -> None:
    """A hundred megabytes go through; of Python's and numpy's allocations a tenth is never exceeded."""
    import tracemalloc

    values = np.zeros(125_000)  # 1 MB
    with RecordSpool(tmp_path / "spool") as spool:
        tracemalloc.start()
        for _ in range(100):
            spool.append({"values": values})
        for _ in reversed(spool):
            pass
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < 15e6  # a block, a copy of one record, and the reading's own


def test_a_record_unlike_the_first_is_refused(tmp_path: Path) -> None:
    with filled(tmp_path / "spool", 1) as spool:
        with pytest.raises(ResultError, match="differs from the first"):
            spool.append({"other": np.zeros(2)})
        with pytest.raises(ResultError, match="differs from the first"):
            spool.append(record(1) | {"matrix": np.zeros((3, 2))})
        assert_holds(reversed(spool), [0])


@pytest.mark.parametrize("content", [None, b"", b"no JSON\n", b"[1]\n", b'{"values": 3}\n'])
def test_a_spool_that_cannot_be_resumed_says_so(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "spool"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ResultError, match="--overwrite"):
        RecordSpool(path, 2, record(0))


@pytest.mark.parametrize("block", [1, 1 << 22])
def test_records_that_are_not_as_they_were_written_are_refused(
    tmp_path: Path, monkeypatch, block: int
) -> None:
    """Each changed byte, and records in each other's place."""
    monkeypatch.setattr(module, "BLOCK_BYTES", block)
    path = tmp_path / "spool"
    filled(path, 3).close()
    data = path.read_bytes()
    start = data.index(b"\n") + 1
    size = (len(data) - start) // 3
    exchanged = data[:start] + data[start + size : start + 2 * size] + data[start : start + size]
    flipped = [data[:at] + bytes([data[at] ^ 16]) + data[at + 1 :] for at in range(0, start + 2 * size, 5)]
    for damaged in (exchanged + data[start + 2 * size :], *flipped):
        path.write_bytes(damaged)
        with pytest.raises(ResultError, match=r"spool cannot be used.*--overwrite"):
            RecordSpool(path, 2, record(0))
    path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))  # of a record that is dropped anyway
    with RecordSpool(path, 2, record(0)) as spool:
        assert_holds(reversed(spool), [1, 0])


@pytest.mark.parametrize("keep", [0, 2])
def test_no_link_is_followed(tmp_path: Path, keep: int) -> None:
    filled(tmp_path / "other", 3).close()
    before = (tmp_path / "other").read_bytes()
    (tmp_path / "spool").symlink_to(tmp_path / "other")
    with pytest.raises(ResultError, match="a symbolic link"):
        RecordSpool(tmp_path / "spool", keep, record(0))
    assert (tmp_path / "other").read_bytes() == before


def test_a_spool_with_too_few_records_says_so(tmp_path: Path) -> None:
    filled(tmp_path / "spool", 2).close()
    with pytest.raises(ResultError, match="ends early"):
        RecordSpool(tmp_path / "spool", 3, record(0))


def test_a_folder_that_is_missing_is_told(tmp_path: Path) -> None:
    with pytest.raises(ResultError, match="nowhere"):
        RecordSpool(tmp_path / "nowhere" / "spool")
