"""Batches of remote recordings: found, copied while a job runs, and kept while they do not change."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import fsspec
import pytest

from posetrack_cli.batch import remote
from posetrack_cli.batch.execution import planned_action, run_job
from posetrack_cli.batch.jobs import Job, Limits, State, input_path, record_path
from posetrack_cli.batch.sources import find_sources
from posetrack_cli.cli.main import run
from posetrack_cli.errors import PosetrackError, UsageError

QUICK = ("--hand-side", "right", "--shape", "average", "--particles", "8", "--end", "2")


@pytest.fixture
def store(monkeypatch: pytest.MonkeyPatch) -> Iterator[fsspec.AbstractFileSystem]:
    """An object store in memory, in the place of one on the network."""
    monkeypatch.setattr(remote, "SCHEMES", ("memory",))
    system = fsspec.filesystem("memory")
    yield system
    system.store.clear()


def job_of(folder: Path, url: str) -> Job:
    (source,) = find_sources([url])
    copy = input_path(folder, source.name, source.path)
    return Job(
        source.name, ("hand", "run"), copy, QUICK, folder / f"{source.name}.mcap",
        record_path(folder, source.name), folder, url=source.url,
    )  # fmt: skip


def test_a_remote_recording_is_tracked_like_a_local_one_and_copied_again_only_after_a_change(
    store: fsspec.AbstractFileSystem, tmp_path: Path
) -> None:
    made, expected, folder = tmp_path / "a.mcap", tmp_path / "expected.mcap", tmp_path / "results"
    assert run(["hand", "synth", "--frames", "2", "-o", str(made)]) == 0
    assert run(["hand", "run", str(made), "-o", str(expected), *QUICK]) == 0
    store.pipe("/day/a.mcap", made.read_bytes())
    folder.mkdir()
    job = job_of(folder, "memory://day/a.mcap")
    assert planned_action(job, Limits()) == "copy and track"
    outcome = run_job(job, Limits())
    assert outcome.state is State.DONE, outcome.reason
    assert not job.recording.exists()
    told = json.loads(job.record.read_text())
    assert json.loads(told["input"]["state"])[0] == "memory://day/a.mcap"
    assert run(["export", str(job.output), "-o", str(tmp_path / "a.csv")]) == 0
    assert run(["export", str(expected), "-o", str(tmp_path / "b.csv")]) == 0
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    assert planned_action(job, Limits()) == "keep"
    assert run_job(job, Limits()).state is State.KEPT
    store.pipe("/day/a.mcap", b"another")
    assert planned_action(job, Limits()) == "copy and track"
    changed = run_job(job, Limits())
    assert changed.state is State.FAILED and not job.recording.exists()


def test_a_stopped_copy_leaves_nothing(store: fsspec.AbstractFileSystem, tmp_path: Path) -> None:
    store.pipe("/a.mcap", b"0" * 100)
    answers = iter([False, True])
    outcome = run_job(job_of(tmp_path, "memory://a.mcap"), Limits(), stopped=lambda: next(answers))
    assert outcome.state is State.STOPPED
    assert not list(tmp_path.rglob("*.mcap"))


def test_patterns_name_results_by_what_they_match(store: fsspec.AbstractFileSystem) -> None:
    for name in ("/in/day1/a.mcap", "/in/day2/a.mcap", "/in/day2/b.txt"):
        store.pipe(name, b"")
    found = find_sources(["memory://in/*/*.mcap"])
    assert [(one.name, one.url) for one in found] == [
        ("day1/a", "memory:///in/day1/a.mcap"),
        ("day2/a", "memory:///in/day2/a.mcap"),
    ]


@pytest.mark.parametrize(
    ("url", "told"),
    [
        ("ftp://host/a.mcap", "unknown kind of URL"),
        ("file:///etc/passwd", "unknown kind of URL"),
        ("memory://a.zip::file:///etc/passwd", "unknown kind of URL"),
        ("memory://none/*.mcap", "no matching recording"),
    ],
)
def test_other_urls_are_refused(store: fsspec.AbstractFileSystem, url: str, told: str) -> None:
    with pytest.raises(UsageError, match=told):
        find_sources([url])


def test_missing_files_and_folders_fail_alone(store: fsspec.AbstractFileSystem, tmp_path: Path) -> None:
    store.pipe("/folder.mcap/a", b"")
    for url in ("memory://none.mcap", "memory://folder.mcap"):
        outcome = run_job(job_of(tmp_path, url), Limits())
        assert outcome.state is State.FAILED and url in outcome.reason and "\n" not in outcome.reason


def test_lists_and_manifests_read_urls_only_on_request(
    store: fsspec.AbstractFileSystem, tmp_path: Path
) -> None:
    store.pipe("/a.mcap", b"")
    names, manifest = tmp_path / "list.txt", tmp_path / "set.toml"
    names.write_text("memory://a.mcap\n")
    manifest.write_text('[[recordings]]\npath = "memory://a.mcap"\nname = "first"\n')
    for path, name in ((names, "a"), (manifest, "first")):
        with pytest.raises(UsageError, match="--remote"):
            find_sources([str(path)])
        (source,) = find_sources([str(path)], remote=True)
        assert (source.name, source.url) == (name, "memory://a.mcap")


def test_names_from_a_server_do_not_leave_the_results_folder(
    store: fsspec.AbstractFileSystem, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(type(store), "glob", lambda system, path: ["/in/../../a.mcap"])
    with pytest.raises(PosetrackError, match="invalid result name"):
        find_sources(["memory://in/*.mcap"])


class Bucket(fsspec.AbstractFileSystem):
    """An object store whose paths begin with the bucket, as those of S3 do."""

    protocol = "bucket"
    names = ("data/day1/a.mcap", "data/day2/b.mcap")

    def ls(self, path: str, detail: bool = True, **options: object) -> list[object]:
        path = self._strip_protocol(path)
        below = {
            "/".join(name.split("/")[: path.count("/") + 2])
            for name in self.names
            if name.startswith(f"{path}/")
        }
        kinds = {one: "file" if one in self.names else "directory" for one in below}
        return [{"name": one, "size": 0, "type": kind} if detail else one for one, kind in kinds.items()]


@pytest.mark.parametrize(
    ("url", "expected"),
    [
        ("bucket://data/day1/a.mcap", [("a", "a.mcap", "bucket://data/day1/a.mcap")]),
        (
            "bucket://data/*/*.mcap",
            [
                ("day1/a", "a.mcap", "bucket://data/day1/a.mcap"),
                ("day2/b", "b.mcap", "bucket://data/day2/b.mcap"),
            ],
        ),
    ],
)
def test_names_do_not_depend_on_how_a_store_writes_paths(
    monkeypatch: pytest.MonkeyPatch, url: str, expected: list[tuple[str, str, str]]
) -> None:
    monkeypatch.setattr(remote, "SCHEMES", ("bucket",))
    fsspec.register_implementation("bucket", Bucket, clobber=True)
    assert [(one.name, str(one.path), one.url) for one in find_sources([url])] == expected


def test_a_query_is_no_part_of_the_name() -> None:
    found = remote._found("https://host/day/a.mcap?signature=b.c", "")
    assert (found.name, found.file) == ("a", "a.mcap")
