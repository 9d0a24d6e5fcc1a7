"""What a batch remembers of a job, and what makes it do one again."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from posetrack_cli.batch import records
from posetrack_cli.batch.jobs import Job, Outcome, Piece, State
from posetrack_cli.batch.records import (
    JobRecord,
    input_digest,
    job_key,
    output_stamp,
    page_key,
    read_record,
    write_record,
)
from posetrack_cli.errors import RecordingError


def make_job(folder: Path, **changes: object) -> Job:
    job = Job("a", ("hand", "run"), folder / "a.mcap", ("--seed=1",), folder / "out.mcap", folder / "a.json")
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
        {"files": 1},
        (3, "digest"),
        "done",
        Outcome("a", State.DONE, "why", ("last",), 0, 1.5, 0.5, 7, 9, True, (Piece(0, 9, 1, 8),), ("dark",)),
    )
    write_record(tmp_path / "a.json", record)
    assert read_record(tmp_path / "a.json") == record


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"format": "another"}', '{"format": "posetrack.batch.job/1"}', "[" * 9999]
)
def test_a_damaged_record_is_none(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.json").write_text(text)
    assert read_record(tmp_path / "a.json") is None
    assert read_record(tmp_path / "gone.json") is None
