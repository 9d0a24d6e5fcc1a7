"""What may be written where, and what is left when writing fails."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from posetrack_cli.errors import PosetrackError, ResultError, UsageError
from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.outputs import (
    check_not_written,
    check_output,
    lock,
    part_path,
    state_path,
    whole_or_nothing,
)


def refused(out: Path, *, overwrite: bool = True, source: Path | None = None) -> PosetrackError:
    with pytest.raises(PosetrackError) as caught:
        check_output(out, overwrite=overwrite, source=source)
    return caught.value


def test_the_source_is_never_replaced(tmp_path: Path) -> None:
    source, link = tmp_path / "a.mcap", tmp_path / "link.mcap"
    source.write_bytes(b"precious")
    link.symlink_to(source)
    for given in (source, link):
        error = refused(source, source=given)
        assert isinstance(error, UsageError) and "would replace the recording" in str(error)
    check_output(tmp_path / "b.mcap", overwrite=True, source=source)


def test_nor_is_a_source_that_has_the_name_the_output_is_written_under(tmp_path: Path) -> None:
    source = part_path(tmp_path / "a.mcap")
    source.write_bytes(b"precious")
    assert "would replace the recording" in str(refused(tmp_path / "a.mcap", source=source))


@pytest.mark.parametrize("name", ["", "a", "a.txt", "a.mcap.part"])
def test_other_names_are_wrong_usage(tmp_path: Path, name: str) -> None:
    error = refused(tmp_path / name if name else Path(name))
    assert isinstance(error, UsageError) and ".mcap" in str(error)


def test_folders_in_the_way_or_missing_are_found_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").mkdir()
    part_path(tmp_path / "b.mcap").mkdir()
    for name in ("a.mcap", "b.mcap"):
        assert "is a folder" in str(refused(tmp_path / name))
    missing = refused(tmp_path / "no" / "a.mcap")
    assert isinstance(missing, ResultError) and "no folder" in str(missing)


def test_results_and_interrupted_runs_are_kept_unless_overwritten(tmp_path: Path) -> None:
    out = tmp_path / "a.mcap"
    part_path(out).touch()
    check_output(out, overwrite=False)  # half a conversion: nothing can go on with it
    state_path(out).touch()
    assert "--resume" in str(refused(out, overwrite=False))
    out.touch()
    assert "already exists" in str(refused(out, overwrite=False))
    check_output(out, overwrite=True)


def test_what_another_process_writes_is_left_alone(tmp_path: Path) -> None:
    out = tmp_path / "a.mcap"
    with McapSink(part_path(out)) as sink:
        sink.flush()
        before = part_path(out).read_bytes()
        with pytest.raises(UsageError, match="being written"), whole_or_nothing(out):
            pass
        assert part_path(out).read_bytes() == before
    with whole_or_nothing(out) as part:
        part.write_bytes(b"whole")


def test_a_failure_leaves_nothing_and_success_the_whole(tmp_path: Path) -> None:
    out = tmp_path / "a.mcap"
    with pytest.raises(KeyboardInterrupt), whole_or_nothing(out) as part:
        part.write_bytes(b"half")
        raise KeyboardInterrupt
    assert not list(tmp_path.iterdir())
    with whole_or_nothing(out) as part:
        part.write_bytes(b"whole")
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_a_lock_ends_with_its_process_also_when_it_is_killed(tmp_path: Path) -> None:
    path = tmp_path / "held"
    code = (
        "import sys, time; from pathlib import Path; from posetrack_cli.outputs import lock; "
        "stream = Path(sys.argv[1]).open('wb'); print(lock(stream), flush=True); time.sleep(600)"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout is not None and holder.stdout.readline() == "True\n"
        with pytest.raises(UsageError, match="is being written by another process"):
            check_not_written(path)
        holder.kill()
    check_not_written(path)
    with path.open("wb") as stream:
        assert lock(stream)


def test_who_asks_keeps_nobody_out(tmp_path: Path) -> None:
    path = tmp_path / "asked"
    path.touch()
    with ThreadPoolExecutor(4) as several:
        asked = [several.submit(check_not_written, path) for _ in range(200)]
    assert [one.result() for one in asked] == [None] * 200
