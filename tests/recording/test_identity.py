"""Digests of inputs: of what is there now, and computed once."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import pytest

from posetrack_cli.errors import RecordingError
from posetrack_cli.phases import Advance, phases_shown
from posetrack_cli.recording import identity
from posetrack_cli.recording.identity import file_digest, files_digest, known_digests, tell_digests


@pytest.fixture(autouse=True)
def nothing_known() -> Iterator[None]:
    identity._known.clear()
    yield
    identity._known.clear()


def changed(path: Path, data: bytes, at_ns: int) -> Path:
    path.write_bytes(data)
    os.utime(path, ns=(at_ns, at_ns))
    return path


def test_a_digest_is_that_of_the_bytes(tmp_path: Path) -> None:
    path = changed(tmp_path / "a", b"some bytes", 1)
    assert file_digest(path) == (10, hashlib.sha256(b"some bytes").hexdigest())


def test_a_file_that_changed_is_read_again(tmp_path: Path) -> None:
    first = file_digest(changed(tmp_path / "a", b"12345", 1))
    assert file_digest(changed(tmp_path / "a", b"67890", 2)) != first
    assert file_digest(changed(tmp_path / "a", b"12345", 3)) == first


def test_what_is_known_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In this process, and in one that is told."""
    path = changed(tmp_path / "a", b"12345", 1)
    files = [("x", path), ("y", changed(tmp_path / "b", b"6", 1))]
    one, several = file_digest(path), files_digest(files)
    told = known_digests()
    identity._known.clear()
    monkeypatch.setattr(identity, "_feed", None)  # calling it would fail
    tell_digests({key: list(value) for key, value in told.items()})  # type: ignore[arg-type, misc]  # as JSON has it
    assert (file_digest(path), files_digest(files)) == (one, several)


def test_names_and_order_of_files_count(tmp_path: Path) -> None:
    a, b = changed(tmp_path / "a", b"1", 1), changed(tmp_path / "b", b"2", 1)
    found = [
        files_digest(files) for files in ([("a", a), ("b", b)], [("b", b), ("a", a)], [("a", a), ("c", b)])
    ]
    assert len(set(found)) == 3


def test_what_is_missing_is_told(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="gone: cannot be read, found No such file"):
        file_digest(tmp_path / "gone")


def test_long_reading_says_how_far_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In pieces of all files together; a short one says nothing."""
    said: list[tuple[str, str, int | None]] = []
    read: list[int] = []

    def shows(name: str, unit: str, total: int | None) -> AbstractContextManager[Advance]:
        said.append((name, unit, total))
        return nullcontext(read.append)

    monkeypatch.setattr(identity, "READ_BYTES", 4)
    monkeypatch.setattr(identity, "LONG_BYTES", 12)
    files = [(name, changed(tmp_path / name, b"12345678", 1)) for name in "ab"]
    with phases_shown(shows):
        file_digest(files[0][1])
        assert said == read == []
        files_digest(files)
    assert said == [("reading for the SHA-256", "MiB", 4)] and sum(read) == 4
