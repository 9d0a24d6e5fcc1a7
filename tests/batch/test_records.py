"""What a batch remembers of a job, and what makes it do one again."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from posetrack_cli import limits
from posetrack_cli.batch import records
from posetrack_cli.batch.jobs import Job, Outcome, Piece, State, record_path
from posetrack_cli.batch.records import (
    FORMAT,
    DamagedRecordError,
    JobRecord,
    input_digest,
    job_key,
    output_stamp,
    page_key,
    read_record,
    write_record,
)
from posetrack_cli.errors import RecordingError
from posetrack_cli.outputs import part_path


def make_job(folder: Path, **changes: object) -> Job:
    out, record = folder / "out.mcap", folder / "a.json"
    job = Job("a", ("hand", "run"), folder / "a.mcap", ("--seed=1",), out, record, folder)
    return replace(job, **changes)  # type: ignore[arg-type]


def test_a_key_depends_on_all_that_changes_a_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = tmp_path / "hand.glb"
    mesh.write_bytes(b"one")
    with_file = make_job(tmp_path, arguments=("--seed=1", f"--hand-mesh={mesh}"))
    keys = [
        job_key(make_job(tmp_path), "digest"),
        job_key(make_job(tmp_path), "another"),
        job_key(make_job(tmp_path, arguments=("--seed=2",)), "digest"),
        job_key(make_job(tmp_path, command=("head", "mono")), "digest"),
        job_key(make_job(tmp_path, chunk_s=10.0), "digest"),
        job_key(make_job(tmp_path, chunk_s=10.0, overlap_s=1.0), "digest"),
        job_key(with_file, "digest"),
    ]
    mesh.write_bytes(b"two")
    keys.append(job_key(with_file, "digest"))
    keys.append(job_key(make_job(tmp_path, sources="of other code"), "digest"))
    monkeypatch.setattr(records, "libraries", lambda: "numpy of another version")
    keys.append(job_key(make_job(tmp_path), "digest"))
    assert len(set(keys)) == len(keys)


def test_a_key_depends_on_nothing_else(tmp_path: Path) -> None:
    job = make_job(tmp_path)
    others = {
        "name": "b",
        "output": tmp_path / "b.mcap",
        "page": tmp_path / "b.html",
        "gates": ("coverage < 1",),
    }
    assert job_key(replace(job, **others), "digest") == job_key(job, "digest")  # type: ignore[arg-type]


def test_a_page_is_another_one_with_another_truth(tmp_path: Path) -> None:
    truth = tmp_path / "truth.csv"
    truth.write_text("1")
    with_page = make_job(tmp_path, page=tmp_path / "a.html")
    keys = {page_key(make_job(tmp_path)), page_key(with_page), page_key(replace(with_page, truth=truth))}
    truth.write_text("2")
    assert len(keys | {page_key(replace(with_page, truth=truth))}) == 4


def test_a_digest_is_of_contents_and_names(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name / "left").mkdir(parents=True)
        (tmp_path / name / "left" / "0.png").write_bytes(b"image")
    a, b = (input_digest(tmp_path / name, {})["sha256"] for name in ("a", "b"))
    assert a == b
    (tmp_path / "b" / "left" / "0.png").rename(tmp_path / "b" / "left" / "1.png")
    assert input_digest(tmp_path / "b", {})["sha256"] != a


def test_what_is_as_it_was_is_not_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"12345")
    known = input_digest(path, {})
    monkeypatch.setattr(records, "file_digest", None)  # calling it would fail
    assert input_digest(path, known) == known
    monkeypatch.undo()
    path.write_bytes(b"67890")
    os.utime(path, ns=(1, 1))
    assert input_digest(path, known)["sha256"] != known["sha256"]


def test_what_is_missing_is_told(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"gone\.mcap: cannot be read, found No such file"):
        input_digest(tmp_path / "gone.mcap", {})


def test_copies_have_the_stamp_of_the_original(tmp_path: Path) -> None:
    path = tmp_path / "result.mcap"
    path.write_bytes(bytes(200_000))
    copy = Path(shutil.copy(path, tmp_path / "copy.mcap"))
    os.utime(copy, ns=(1, 1))
    assert output_stamp(copy) == output_stamp(path)
    with copy.open("r+b") as stream:
        stream.seek(-100, os.SEEK_END)
        stream.write(b"x")
    assert output_stamp(copy) != output_stamp(path)
    assert output_stamp(tmp_path / "gone.mcap") == ()


def test_a_record_reads_back(tmp_path: Path) -> None:
    record = JobRecord(
        "key",
        "page",
        {"state": "1", "sha256": "2"},
        (3, "digest"),
        "done",
        Outcome("a", State.DONE, "why", ("last",), 0, 1.5, 0.5, 7, 9, True, (Piece(0, 9, 1, 8),), ("dark",)),
    )
    write_record(tmp_path / "a.json", record)
    assert read_record(tmp_path / "a.json") == record


def test_a_record_that_is_not_there_is_none(tmp_path: Path) -> None:
    assert read_record(tmp_path / "gone.json") is None


WRITTEN = {"key": "k", "state": "done", "format": FORMAT, "outcome": {"name": "a", "state": "done"}}


@pytest.mark.parametrize(
    "text",
    [
        *("", "{", "[]", '{"format": "another"}', "[" * 9999),
        json.dumps({**WRITTEN, "format": "posetrack.batch.job/1"}),
        json.dumps({**WRITTEN, "output": [-1, "x"]}),
        json.dumps({**WRITTEN, "key": "\udcff"}),
        *(
            json.dumps({**WRITTEN, "outcome": {**WRITTEN["outcome"], **wrong}})  # type: ignore[dict-item]
            for wrong in (
                *({name: 10**400} for name in ("frames", "peak_bytes", "exit_code")),
                *({"seconds": number} for number in (float("nan"), float("inf"), -1.0, 1e300)),
                *({"frames": "9"}, {"frames": True}, {"remarks": ["\ud800"]}, {"state": "unknown"}),
            )
        ),
    ],
)
def test_nothing_of_a_damaged_record_is_believed(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(DamagedRecordError, match=r"a\.json: job record"):
        read_record(tmp_path / "a.json")


def test_what_is_damaged_above_is_read_otherwise(tmp_path: Path) -> None:
    """It is the numbers and texts that are refused, not the rest of the record."""
    (tmp_path / "a.json").write_text(json.dumps(WRITTEN))
    record = read_record(tmp_path / "a.json")
    assert record is not None
    assert record.outcome == Outcome("a", State.DONE)


NAMES = (
    "a",
    "a.json",
    "a.log",
    "a.pieces",
    "a.pieces/00000",
    "a.json.part",
    "a.dir",
    "a.dir/b",
    "a/b",
    "lock",
    "lock/a",
)


def test_no_job_has_the_place_of_another_ones_record_or_folder() -> None:
    records = [record_path(Path("out"), name) for name in NAMES]
    files = [
        file
        for one in records
        for file in (one, one.with_suffix(".log"), one.with_suffix(".pieces"), part_path(one))
    ]
    folders = {folder for one in records for folder in one.parents}
    pieces = {one.with_suffix(".pieces") for one in records}
    assert len(set(files)) == len(files)
    assert folders.isdisjoint(files)
    assert all(not pieces & set(one.parents) for one in records)
    assert all(one.is_relative_to("out/.batch/records") for one in records)


def test_a_recording_of_too_many_files_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "SEARCH_ENTRIES", 2)
    for number in range(3):
        (tmp_path / f"{number}.png").write_bytes(b"")
    with pytest.raises(RecordingError, match="folder has too many files, expected at most 2"):
        input_digest(tmp_path, {})
