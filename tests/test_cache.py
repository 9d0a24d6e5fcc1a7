"""What is computed once: the same arrays the next time, others for other arguments, and no harm done."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli import cache
from posetrack_cli.cache import cached_arrays
from posetrack_cli.npz import Arrays

SOURCES = ("rendering/mesh.py",)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where what is computed here is kept."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    return tmp_path / "posetrack" / "numbers"


class Counted:
    """A computation that counts its calls."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self) -> Arrays:
        self.calls += 1
        return {"halves": np.arange(5) / 2.0, "whole": np.arange(3)}


def kept(compute: Callable[[], Arrays], *arguments: object) -> Arrays:
    return cached_arrays("numbers", SOURCES, arguments, compute)


def test_the_second_time_it_is_read(folder: Path) -> None:
    counted = Counted()
    first, second = (kept(counted, np.eye(2), 3) for _ in range(2))
    assert counted.calls == 1
    for name, values in first.items():
        np.testing.assert_array_equal(second[name], values)
        assert second[name].dtype == values.dtype
    assert len(list(folder.iterdir())) == 1


def test_other_arguments_are_another_computation(folder: Path) -> None:
    counted = Counted()
    for arguments in ((np.eye(2), 3), (np.eye(2), 4), (np.eye(3), 3), (np.eye(2, dtype=np.float32), 3)):
        kept(counted, *arguments)
    assert counted.calls == 4
    cached_arrays("numbers", ("rendering/port.py",), (np.eye(2), 3), counted)
    assert counted.calls == 5  # and so is another source


def test_a_damaged_file_is_made_anew(folder: Path) -> None:
    counted = Counted()
    kept(counted, 1)
    file = next(folder.iterdir())
    for damage in (b"", b"PK", file.read_bytes()[:-30]):
        file.write_bytes(damage)
        before = counted.calls
        np.testing.assert_array_equal(kept(counted, 1)["whole"], np.arange(3))
        assert counted.calls == before + 1
        kept(counted, 1)
        assert counted.calls == before + 1


def test_where_nothing_can_be_written_it_is_computed_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "cache_folder", lambda name: None)
    counted = Counted()
    assert [len(kept(counted, 1)) for _ in range(2)] == [2, 2]
    assert counted.calls == 2


def test_a_full_disk_hinders_nobody(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    assert len(kept(Counted(), 1)) == 2
    assert list(folder.iterdir()) == []
