from __future__ import annotations

import re
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.errors import PosetrackError, ResultError, UsageError
from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.outputs import part_path, state_path
from posetrack_cli.results import ResultWriter, Subject
from support.results import (
    CAMERA,
    RUN,
    SUBJECT,
    begin,
    checkpoint_at,
    make_estimate,
    make_vertices,
    resume_result,
    write_frames,
    write_result,
)

FRAMES = 26
ENDS = range(FRAMES)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return write_result(tmp_path_factory.mktemp("whole") / "r.mcap", FRAMES).read_bytes()


def killed(folder: Path, frames: int, run: Mapping[str, str] = RUN) -> Path:
    """Return a result in the state in which a kill after so many frames leaves the disk."""
    (folder / "live").mkdir()
    writer = begin(folder / "live" / "r.mcap", run=run)
    write_frames(writer, 0, frames)
    for path in (folder / "live").iterdir():
        shutil.copy(path, folder)  # what is in the process's buffers stays behind
    writer.abort()
    return folder / "r.mcap"


def aborted(folder: Path, frames: int) -> Path:
    with begin(folder / "r.mcap") as writer:
        write_frames(writer, 0, frames)
    return folder / "r.mcap"


@pytest.mark.parametrize("interrupt", [killed, aborted])
@pytest.mark.parametrize("frames", ENDS)
def test_resumed_equals_uninterrupted(tmp_path: Path, whole: bytes, frames: int, interrupt) -> None:
    path = interrupt(tmp_path, frames)
    found = resume_result(path, FRAMES)
    assert found.frame_index == frames // 10 * 10 - 1
    assert path.read_bytes() == whole
    assert [p.name for p in tmp_path.iterdir() if p.is_file()] == ["r.mcap"]


@pytest.mark.parametrize("cut", [1, 100, 700])
def test_a_chunk_cut_short_after_the_checkpoint_is_dropped(tmp_path: Path, whole: bytes, cut: int) -> None:
    path = aborted(tmp_path, 12)
    flushed = killed_size(tmp_path, 12)
    part_path(path).write_bytes(part_path(path).read_bytes()[: flushed + cut])
    resume_result(path, FRAMES)
    assert path.read_bytes() == whole


def killed_size(folder: Path, frames: int) -> int:
    (folder / "other").mkdir()
    return part_path(killed(folder / "other", frames)).stat().st_size


def test_a_kill_between_flush_and_checkpoint_drops_the_newer_frames(tmp_path: Path, whole: bytes) -> None:
    with begin(tmp_path / "r.mcap") as writer:
        write_frames(writer, 0, 19)
        old_state = state_path(tmp_path / "r.mcap").read_bytes()
        write_frames(writer, 19, 20)
    state_path(tmp_path / "r.mcap").write_bytes(old_state)
    assert resume_result(tmp_path / "r.mcap", FRAMES).frame_index == 9
    assert (tmp_path / "r.mcap").read_bytes() == whole


def test_a_run_can_be_interrupted_again_and_again(tmp_path: Path, whole: bytes) -> None:
    path = killed(tmp_path, 12)
    writer, checkpoint = ResultWriter.resume(path, SUBJECT, CAMERA, RUN)
    write_frames(writer, checkpoint.frame_index + 1, 15)
    writer.abort()
    writer, checkpoint = ResultWriter.resume(path, SUBJECT, CAMERA, RUN)
    write_frames(writer, checkpoint.frame_index + 1, 23)
    writer.abort()
    assert resume_result(path, FRAMES).frame_index == 19
    assert path.read_bytes() == whole


def test_chunks_that_end_by_their_size_are_replayed_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: bytes
) -> None:
    defaults = McapSink.__init__.__kwdefaults__ | {"chunk_bytes": 5000}
    monkeypatch.setattr(McapSink.__init__, "__kwdefaults__", defaults)
    uninterrupted = write_result(tmp_path / "whole.mcap", FRAMES).read_bytes()
    path = killed(tmp_path, 17)
    resume_result(path, FRAMES)
    assert path.read_bytes() == uninterrupted
    assert uninterrupted != whole


def test_the_tracker_gets_its_state_back_bit_by_bit(tmp_path: Path) -> None:
    path = killed(tmp_path, 12)
    writer, found = ResultWriter.resume(path, SUBJECT, CAMERA, RUN)
    writer.abort()
    np.testing.assert_array_equal(found.arrays["particles"], np.full((3, 2), 9.0))
    assert found.state == {"bit_generator": {"state": 2**127 + 9}}
    assert (found.frame_index, found.frames_written) == (9, 10)


def refused(path: Path, **changes: object) -> PosetrackError:
    """Return the error of resuming with these changes, after checking that nothing was harmed."""
    before = {p.name: p.read_bytes() for p in path.parent.iterdir() if p.is_file()}
    options = {"subject": SUBJECT, "camera": CAMERA, "run": RUN} | changes
    with pytest.raises(PosetrackError) as caught:
        ResultWriter.resume(path, **options)
    assert {p.name: p.read_bytes() for p in path.parent.iterdir() if p.is_file()} == before
    return caught.value


def test_another_run_record_is_refused_and_named(tmp_path: Path) -> None:
    path = killed(tmp_path, 12)
    error = refused(path, run=RUN | {"seed": "2", "extra": "x"})
    assert isinstance(error, UsageError)
    assert "found extra=nothing seed=1, expected extra=x seed=2; resume with its original options" in str(
        error
    )
    assert "version" not in str(error)


def test_a_recording_that_is_typed_otherwise_is_the_same(tmp_path: Path) -> None:
    """From another folder, or after it has moved: its SHA-256 counts."""
    path = killed(tmp_path, 12)
    for place in ("elsewhere/r.mcap", "r.mcap"):
        writer, checkpoint = ResultWriter.resume(path, SUBJECT, CAMERA, RUN | {"input.path": place})
        write_frames(writer, checkpoint.frame_index + 1, FRAMES)
        writer.abort()


@pytest.mark.parametrize(
    ("key", "then", "now", "words"),
    [
        ("sources", "0123", "4567", "posetrack build, found 0123, expected 4567"),
        ("libraries", "numpy 2.4, scipy 1.1", "numpy 2.5, scipy 1.1", "found numpy 2.4, expected numpy 2.5"),
        ("processor", "x86_64, openblas A", "x86_64, openblas B", "found openblas A, expected openblas B"),
        ("sources", None, "4567", "found nothing, expected 4567"),
    ],
)
def test_what_another_posetrack_began_is_refused(
    tmp_path: Path, key: str, then: str | None, now: str, words: str
) -> None:
    begun = RUN if then is None else RUN | {key: then}
    path = killed(tmp_path, 12, run=begun)
    error = refused(path, run=RUN | {key: now, "configuration": "of another default"})
    assert re.search(f"the unfinished result was made with a different .*{words}", str(error))
    assert "start again with --overwrite" in str(error) and "configuration" not in str(error)


def other_subject() -> Subject:
    return replace(SUBJECT, point_names=("a", "b", "c", "d"))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"subject": other_subject()}, "point_names="),
        ({"camera": replace(CAMERA, fx=366.0)}, "another camera"),
        ({"flush_frames": 5}, "found 10 frames, expected 5 frames"),
    ],
)
def test_another_subject_camera_or_spacing_is_refused(
    tmp_path: Path, changes: dict[str, object], message: str
) -> None:
    error = refused(killed(tmp_path, 12), **changes)
    assert isinstance(error, UsageError)
    assert message in str(error)


def test_nothing_to_resume_is_an_error(tmp_path: Path) -> None:
    assert "no unfinished result to resume" in str(refused(tmp_path / "r.mcap"))


def test_a_missing_checkpoint_is_an_error(tmp_path: Path) -> None:
    path = killed(tmp_path, 12)
    state_path(path).unlink()
    assert "no checkpoint to resume from; start again with --overwrite" in str(refused(path))


@pytest.mark.parametrize(
    "damage", [lambda b: b[:100], lambda b: b"", lambda b: b[:300] + b"\x00" * 50 + b[350:]]
)
def test_a_damaged_checkpoint_is_an_error(tmp_path: Path, damage) -> None:
    path = killed(tmp_path, 12)
    state_path(path).write_bytes(damage(state_path(path).read_bytes()))
    assert "checkpoint cannot be read" in str(refused(path))


def test_a_checkpoint_newer_than_the_file_is_an_error(tmp_path: Path) -> None:
    path = killed(tmp_path, 12)
    part_path(path).write_bytes(part_path(path).read_bytes()[:-10])
    assert "checkpoint does not match the unfinished result" in str(refused(path))


def test_a_checkpoint_of_another_run_is_an_error(tmp_path: Path) -> None:
    path = killed(tmp_path, 12)
    (tmp_path / "other").mkdir()
    with ResultWriter(tmp_path / "other" / "r.mcap", SUBJECT, CAMERA, RUN | {"seed": "2"}) as writer:
        writer.save_checkpoint(checkpoint_at(writer, -1))
    shutil.copy(state_path(tmp_path / "other" / "r.mcap"), state_path(path))
    assert "checkpoint belongs to another run" in str(refused(path))


def test_a_damaged_chunk_before_the_checkpoint_is_an_error(tmp_path: Path) -> None:
    path = killed(tmp_path, 12)
    data = bytearray(part_path(path).read_bytes())
    data[-3000] ^= 0xFF
    part_path(path).write_bytes(data)
    error = refused(path)
    assert isinstance(error, ResultError)
    assert "is damaged" in str(error)


def test_a_finished_result_has_nothing_to_resume(tmp_path: Path) -> None:
    write_result(tmp_path / "r.mcap")
    assert "no unfinished result" in str(refused(tmp_path / "r.mcap"))


def test_a_resumed_writer_counts_on(tmp_path: Path) -> None:
    writer, _ = ResultWriter.resume(killed(tmp_path, 12), SUBJECT, CAMERA, RUN)
    with writer:
        assert (writer.frames_written, writer.truth_messages) == (10, 5)
        writer.write(make_estimate(10), make_vertices(10))
        assert writer.frames_written == 11
