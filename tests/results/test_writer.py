from __future__ import annotations

import filecmp
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.outputs import part_path, state_path
from posetrack_cli.results import Checkpoint, ResultWriter, read_result
from support.results import (
    CAMERA,
    RUN,
    SUBJECT,
    SUMMARY,
    begin,
    checkpoint_at,
    make_estimate,
    make_truth,
    make_vertices,
    with_fields,
    write_frames,
    write_result,
)

TESTS = Path(__file__).parents[1]
FILE_LIMIT = 20_000  # bytes: room for the schemas and a few chunks, not for the whole run


def frame_indices(path: Path) -> list[int]:
    return [estimate.frame_index for estimate in read_result(path).estimates()]


def test_two_runs_give_the_same_bytes(tmp_path: Path) -> None:
    one, two = write_result(tmp_path / "one.mcap"), write_result(tmp_path / "two.mcap")
    assert filecmp.cmp(one, two, shallow=False)


def test_finish_leaves_the_result_alone_in_its_folder(tmp_path: Path) -> None:
    write_result(tmp_path / "r.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["r.mcap"]


def test_records_state_the_run_and_its_counts(tmp_path: Path) -> None:
    result = read_result(write_result(tmp_path / "r.mcap"))
    assert result.run == RUN
    lost = sum(index % 7 == 3 for index in range(26))
    assert result.summary == {"frames": "26", "lost": str(lost), "reinitialised": "0", "skipped": "0"}


def test_chunks_end_where_frames_are_flushed(tmp_path: Path) -> None:
    path = write_result(tmp_path / "r.mcap", flush_frames=4)
    with path.open("rb") as stream:
        assert len(make_reader(stream).get_summary().chunk_indexes) == 7  # 6 times 4 frames, and 2


def test_attachments_are_carried(tmp_path: Path) -> None:
    with write_result(tmp_path / "r.mcap").open("rb") as stream:
        attachments = [(a.name, a.media_type, a.data) for a in make_reader(stream).iter_attachments()]
    assert attachments == [("model.txt", "text/plain", b"a model")]


def test_a_killed_writer_leaves_every_flushed_frame(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "support.results", tmp_path / "r.mcap", "17"],
        check=False,
        timeout=60,
        cwd=TESTS,
    )
    assert done.returncode == -signal.SIGKILL
    result = read_result(part_path(tmp_path / "r.mcap"))
    assert result.truncated
    assert not result.finished
    assert result.run == RUN
    assert frame_indices(result.path) == list(range(10))


def test_a_writer_killed_before_its_first_flush_leaves_the_run_record(tmp_path: Path) -> None:
    with begin(tmp_path / "r.mcap"):
        result = read_result(part_path(tmp_path / "r.mcap"))
        assert result.truncated
        assert result.run == RUN
        assert list(result.estimates()) == []


def test_abort_leaves_all_frames_and_an_index(tmp_path: Path) -> None:
    writer = begin(tmp_path / "r.mcap")
    write_frames(writer, 0, 17)
    writer.abort()
    writer.abort()
    result = read_result(part_path(tmp_path / "r.mcap"))
    assert (result.truncated, result.finished) == (False, False)
    assert frame_indices(result.path) == list(range(17))
    assert not (tmp_path / "r.mcap").exists()


def test_an_exception_aborts_and_is_the_one_told(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), begin(tmp_path / "r.mcap") as writer:
        write_frames(writer, 0, 3)
        raise KeyboardInterrupt
    assert frame_indices(part_path(tmp_path / "r.mcap")) == [0, 1, 2]


def test_an_existing_result_is_refused_and_kept(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(UsageError, match=r"r\.mcap: already exists; use --overwrite"):
        begin(path)
    assert path.read_bytes() == b"precious"
    assert len(write_result(path, overwrite=True).read_bytes()) > 1000


def test_an_interrupted_run_is_refused_and_kept(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    with begin(path) as writer:
        write_frames(writer, 0, 12)
    before = part_path(path).read_bytes()
    with pytest.raises(UsageError, match="interrupted run; use --resume to continue it or --overwrite"):
        begin(path)
    assert part_path(path).read_bytes() == before


def test_overwriting_an_interrupted_run_discards_its_checkpoint(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    with begin(path) as writer:
        write_frames(writer, 0, 12)
    ResultWriter(path, SUBJECT, CAMERA, RUN, overwrite=True).abort()
    assert not state_path(path).exists()


def test_a_result_that_is_being_written_is_left_alone(tmp_path: Path) -> None:
    """Neither --overwrite nor --resume of a second run touches it; both may once it has ended."""
    path = tmp_path / "r.mcap"
    others = (
        lambda: ResultWriter(path, SUBJECT, CAMERA, RUN, overwrite=True),
        lambda: ResultWriter.resume(path, SUBJECT, CAMERA, RUN)[0],
    )
    with begin(path) as writer:
        write_frames(writer, 0, 12)
        for other in others:
            with pytest.raises(UsageError, match="being written by another process"):
                other()
    with others[1]() as writer:  # resumed, so under a new inode
        with pytest.raises(UsageError, match="being written by another process"):
            others[0]()
        write_frames(writer, writer.frames_written, 15)
        writer.finish(SUMMARY)
    assert frame_indices(path) == list(range(15))


def test_a_missing_folder_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ResultError, match=r"gone/r\.mcap: cannot be written, found no folder .*gone$"):
        begin(tmp_path / "gone" / "r.mcap")


def test_a_folder_in_the_way_is_one_line(tmp_path: Path) -> None:
    part_path(tmp_path / "r.mcap").mkdir()
    with pytest.raises(ResultError, match="cannot be written, found Is a directory"):
        begin(tmp_path / "r.mcap")


DISK_FULL = """
import resource, signal, sys
from pathlib import Path
from support.results import begin, write_frames
from posetrack_cli.errors import ResultError
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
writer = begin(Path(sys.argv[1]))
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), int(sys.argv[2])))
try:
    with writer:
        write_frames(writer, 0, 500)
except ResultError as error:
    print(error)
"""


def test_a_full_disk_is_one_line_and_keeps_what_was_flushed(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    command = [sys.executable, "-W", "error", "-c", DISK_FULL, path, str(FILE_LIMIT)]
    done = subprocess.run(command, check=True, timeout=60, capture_output=True, text=True, cwd=TESTS)
    assert done.stdout == f"{part_path(path)}: cannot be written, found File too large\n"
    assert done.stderr == ""
    kept = frame_indices(part_path(path))
    assert kept == list(range(len(kept)))
    assert len(kept) >= 10
    assert part_path(path).stat().st_size <= FILE_LIMIT


def test_a_bad_estimate_is_refused_and_the_file_goes_on(tmp_path: Path) -> None:
    with begin(tmp_path / "r.mcap") as writer:
        write_frames(writer, 0, 1)
        with pytest.raises(ResultError, match="position is not finite"):
            writer.write(with_fields(make_estimate(1), position=np.full(3, np.nan)))
        write_frames(writer, 1, 3)
        writer.finish(SUMMARY)
    assert frame_indices(tmp_path / "r.mcap") == [0, 1, 2]


def test_a_mesh_that_is_refused_leaves_no_half_frame(tmp_path: Path) -> None:
    with begin(tmp_path / "r.mcap") as writer:
        write_frames(writer, 0, 1)
        with pytest.raises(ResultError, match="mesh"):
            writer.write(make_estimate(1), make_vertices(1, 2))
        writer.finish(SUMMARY)
    with (tmp_path / "r.mcap").open("rb") as stream:
        counts = make_reader(stream).get_summary().statistics.channel_message_counts
    assert max(counts.values()) == 1


def test_truth_must_be_on_a_truth_topic(tmp_path: Path) -> None:
    message = make_truth(0)
    object.__setattr__(message, "topic", "/hand/estimate")
    with begin(tmp_path / "r.mcap") as writer, pytest.raises(ResultError, match=r"not a truth topic"):
        writer.add_truth(message)


@pytest.mark.parametrize("shift", [-1, 1])
def test_a_checkpoint_of_another_frame_is_refused(tmp_path: Path, shift: int) -> None:
    with begin(tmp_path / "r.mcap") as writer:
        write_frames(writer, 0, 12)
        with pytest.raises(ResultError, match="expected frame 9, 10 written"):
            writer.save_checkpoint(Checkpoint(9 + shift, 10))


def test_a_state_of_objects_is_refused(tmp_path: Path) -> None:
    with begin(tmp_path / "r.mcap") as writer:
        for state in ({"arrays": {"a": np.array([object()])}}, {"state": {"a": object()}}):
            with pytest.raises(ResultError, match="cannot be saved"):
                writer.save_checkpoint(Checkpoint(-1, 0, **state))


def test_a_closed_writer_says_so(tmp_path: Path) -> None:
    writer = begin(tmp_path / "r.mcap")
    writer.finish(SUMMARY)
    for call in (
        lambda: writer.write(make_estimate(0)),
        lambda: writer.finish({}),
        lambda: checkpoint(writer),
    ):
        with pytest.raises(ResultError, match="result is closed"):
            call()


def checkpoint(writer: ResultWriter) -> None:
    writer.save_checkpoint(checkpoint_at(writer, -1))
