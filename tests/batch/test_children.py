"""Processes of jobs: what they tell, and how they are ended. A program of the tests stands in for ours."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from posetrack_cli.batch import execution
from posetrack_cli.batch.execution import ProcessResult, failure_reason, run_child, was_interrupted
from posetrack_cli.batch.jobs import Job, Limits

PROGRAM = """
import json, os, signal, sys, time
told = os.fdopen(int(sys.argv[1]), "w", buffering=1)
task = json.loads(sys.stdin.readline())
way = task["arguments"][0]
with open(os.path.join(os.path.dirname(__file__), "pid"), "w") as stream:
    stream.write(str(os.getpid()))
def stop(*_):
    print("stopping")
    sys.exit(130)
signal.signal(signal.SIGINT, stop)
told.write(json.dumps({"progress": ["hand", 3, 9]}) + "\\n")
told.write(json.dumps({"remark": "dark"}) + "\\n")
print("threads", os.environ["POSETRACK_THREADS"])
print("\\x1b[31mred", flush=True)
if way == "abort":
    os.abort()
if way == "exit":
    print("posetrack: a.mcap: is no recording", file=sys.stderr)
    sys.exit(1)
if way == "forever":
    time.sleep(600)
if way == "deaf":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    print("deaf", flush=True)
    time.sleep(600)
told.write(json.dumps({"tracked": 9, "cpu_s": 0.5}) + "\\n{")
"""


@pytest.fixture(autouse=True)
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "stand_in.py").write_text(PROGRAM)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(execution, "_PROGRAM", "stand_in")


def run(folder: Path, way: str, **options: object) -> ProcessResult:
    job = Job("a", ("hand", "run"), folder / "a.mcap", (), folder / "out.mcap", folder / "a.json", folder)
    return run_child(job, (way,), Limits(threads=3, timeout_s=options.pop("timeout_s", None)), **options)  # type: ignore[arg-type]


def test_a_process_tells_how_far_it_is_and_what_it_did(tmp_path: Path) -> None:
    seen: list[tuple[str, int, int | None]] = []
    ending = run(tmp_path, "go", progress=lambda *told: seen.append(told))
    assert (ending.code, ending.messages, ending.remarks) == (0, {"tracked": 9, "cpu_s": 0.5}, ["dark"])
    assert seen == [("hand", 3, 9)]
    assert (tmp_path / "a.log").read_text().startswith("threads 3\n")


def test_its_last_lines_are_kept_and_safe_to_print(tmp_path: Path) -> None:
    ending = run(tmp_path, "exit")
    assert ending.last_lines == ("threads 3", "\\x1b[31mred", "posetrack: a.mcap: is no recording")
    assert failure_reason(ending, Limits()) == "a.mcap: is no recording"


def test_a_process_that_aborts_is_told_by_its_signal(tmp_path: Path) -> None:
    ending = run(tmp_path, "abort")
    assert failure_reason(ending, Limits()) == "process was killed by SIGABRT"
    words = "process was killed by SIGABRT, possibly because of --memory-limit 512M"
    assert failure_reason(ending, Limits(memory_bytes=1 << 29)) == words
    assert not was_interrupted(ending)


def test_a_process_is_stopped_when_its_time_is_over(tmp_path: Path) -> None:
    ending = run(tmp_path, "forever", timeout_s=1.5)
    assert (ending.timed_out, ending.stopped) == (True, False)
    assert ending.last_lines[-1] == "stopping"  # it was asked to, and could save what it had
    assert failure_reason(ending, Limits(timeout_s=1.5)) == "exceeded --timeout 1.5 s"
    assert not was_interrupted(ending)


def test_a_process_is_stopped_when_the_batch_is(tmp_path: Path) -> None:
    log = tmp_path / "a.log"
    ending = run(tmp_path, "forever", stopped=lambda: "red" in log.read_text())
    assert was_interrupted(ending)
    assert ending.code == 130


def test_a_process_that_does_not_stop_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(execution, "_GRACE_S", 0.5)
    log = tmp_path / "a.log"
    ending = run(tmp_path, "deaf", stopped=lambda: "deaf" in log.read_text())
    assert ending.code == -9


def test_nothing_is_left_behind_by_an_error(tmp_path: Path) -> None:
    log = tmp_path / "a.log"

    def fail() -> bool:
        if "red" in log.read_text():
            raise RuntimeError
        return False

    before = time.monotonic()
    with pytest.raises(RuntimeError):
        run(tmp_path, "forever", stopped=fail)
    assert time.monotonic() - before < 60.0  # it slept for 600
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)
