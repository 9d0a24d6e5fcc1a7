"""The harness sees what breaks the invariant: each rule is shown an outcome that does, and a process."""

from __future__ import annotations

from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import pytest

from hostile.case import Case, Link, Pipe, load, save
from hostile.fuzz import Tally, failure_class, turns
from hostile.invariant import MEMORY_BYTES, violations
from hostile.running import Harness, Outcome

CASE = Case("x", ("info", "r.mcap"), {"r.mcap": b"x"}, ("out.mcap",))
FILES = {"r.mcap": "1"}
DONE = Outcome(0, "", b"r.mcap: MCAP\n", b"", 0.1, 1000, FILES, FILES)
FAILED = replace(DONE, code=1, out=b"", error=b"posetrack: r.mcap: is not an MCAP file\n")
LOST = replace(DONE, code=3, error=b"r.mcap: 3 frames lost\n")


@pytest.mark.parametrize("outcome", [DONE, FAILED, LOST, replace(FAILED, code=2)])
def test_an_outcome_as_it_must_be(outcome: Outcome) -> None:
    assert violations(CASE, outcome) == []


TRACE = b"Traceback (most recent call last):\nValueError: x\n"
BROKEN = {
    "traceback": (replace(FAILED, error=TRACE), "0 lines 'posetrack: ...'"),
    "traceback and a line": (replace(FAILED, error=FAILED.error + TRACE), "'Traceback' is said"),
    "no line": (replace(FAILED, error=b""), "0 lines"),
    "two lines": (replace(FAILED, error=2 * FAILED.error), "2 lines"),
    "a line without a failure": (replace(DONE, error=FAILED.error), "without a failure"),
    "internal error": (replace(FAILED, error=b"posetrack: internal error: ValueError\n"), "'internal error'"),
    "damage that no adapter declares": (
        replace(FAILED, error=b"posetrack: r.bag: is damaged here, found KeyError\n"),
        "'is damaged here' is said",
    ),
    "a warning": (replace(DONE, error=b"x.py:3: RuntimeWarning: overflow\n"), "foreign line"),
    "a library's line": (replace(FAILED, error=b"libpng error: bad\n" + FAILED.error), "foreign line"),
    "out of memory": (
        replace(FAILED, error=b"posetrack: out of memory; try fewer\n"),
        "nothing else had stopped",
    ),
    "exit code 4": (replace(DONE, code=4), "exit code 4"),
    "killed": (replace(DONE, code=-9), "exit code -9"),
    "hang": (replace(DONE, code=-9, ended="blocked"), "hang: blocked"),
    "memory": (replace(DONE, peak_bytes=MEMORY_BYTES + 1), "MiB of memory"),
    "CPU": (replace(DONE, cpu_s=5.1), "s of CPU"),
    "an extra file": (replace(DONE, after={**FILES, "pwned": "2"}), "file pwned was made"),
    "an input changed": (replace(DONE, after={"r.mcap": "2"}), "file r.mcap was changed"),
    "an input gone": (replace(DONE, after={}), "file r.mcap was gone"),
    "a temporary file": (replace(DONE, after={**FILES, "$TMPDIR/x": "2"}), "file $TMPDIR/x was made"),
    "an escape on output": (replace(DONE, out=b"\x1b[2J"), "control character U+001B"),
    "C1 on error": (replace(FAILED, error="posetrack: \x9b\n".encode()), "control character U+009B"),
    "bidi": (replace(DONE, out="\u202e".encode()), "control character U+202E"),
    "not UTF-8": (replace(DONE, out=b"\xff"), "is not UTF-8"),
    "a module": (replace(DONE, modules=("sensor_msgs",)), "imported sensor_msgs"),
    "a process": (replace(DONE, events=("os.system ('id',)",)), "os.system"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_each_violation_is_told(name: str) -> None:
    outcome, expected = BROKEN[name]
    told = violations(CASE, outcome)
    assert any(expected in line for line in told), told


def test_an_unfinished_result_may_stay_and_must_where_it_is_resumed() -> None:
    part = {**FILES, "out.mcap.part": "1"}
    assert violations(CASE, replace(FAILED, after=part)) == []
    resuming = replace(CASE, command=("hand", "run", "r.mcap", "-o", "out.mcap", "--resume"))
    gone = replace(FAILED, before=part, after=FILES)
    assert violations(resuming, gone) == ["file out.mcap.part was deleted while resuming"]
    assert violations(resuming, replace(DONE, before=part, after={**FILES, "out.mcap": "1"})) == []


def test_failures_of_one_line_of_code_are_one_class() -> None:
    trace = b'Traceback\n  File "/a/posetrack_cli/b.py", line 3, in c\n    d\nKeyError: 1\n'
    one, other = replace(FAILED, error=trace), replace(FAILED, error=trace.replace(b"1", b"2"))
    assert failure_class(["x"], one) == "KeyError posetrack_cli/b.py:3:c" == failure_class(["y"], other)
    tally = Tally()
    tally.add(replace(CASE, files={"r.mcap": b"longer"}), one, ["x"])
    tally.add(CASE, other, ["y"])
    (failure,) = tally.failures.values()
    assert (failure.count, failure.case, tally.failed.total()) == (2, CASE, 2)


def test_a_kept_case_is_read_again(tmp_path: Path) -> None:
    case = replace(CASE, files={"a/\udcff": b"1", "l": Link("a"), "p": Pipe(), "\x1b[2J": b""})
    save(case, tmp_path / "kept", {"broken": []})
    assert load(tmp_path / "kept") == case


def test_every_target_has_its_turns_until_it_had_its_cases() -> None:
    tally, seen = Tally(), list[str]()
    for target, _ in turns(Namespace(seed=1, target=["few", "many"], cases=3), tally):
        seen.append(target)
        tally.tried[target] += 1 if target == "few" else 2
    assert seen == ["few", "many", "few", "many", "few"]
    assert list(turns(Namespace(seed=1, target=["few"], cases=3), tally)) == []


# What a real process does is seen


ATTACKS = {
    "a traceback": ("raise ValueError(1)", "0 lines"),
    "an exit code": ("import os; os._exit(4)", "exit code 4"),
    "a signal": ("import os; os.kill(os.getpid(), 11)", "exit code -11"),
    "an extra file": ("open('pwned', 'w').close()", "file pwned was made"),
    "a file elsewhere": ("open('../elsewhere', 'w').close()", "elsewhere"),
    "a temporary file": ("import tempfile; tempfile.mkstemp()", "file $TMPDIR/"),
    "an input changed": ("open('r.mcap', 'w').close()", "file r.mcap was changed"),
    "memory": ("b = b'x' * (1200 << 20)", "of memory above"),
    "CPU": (
        "import time; end = time.process_time() + 1.3\nwhile time.process_time() < end: pass",
        "s of CPU",
    ),
    "a hang": ("import time; time.sleep(1000)", "hang: blocked"),
    "a process": ("import os; os.system('true')", "os.system"),
    "another process": ("import subprocess; subprocess.run(['true'])", "subprocess.Popen"),
    "a connection": ("import socket; socket.socket().connect_ex(('127.0.0.1', 9))", "socket.connect"),
    "a module": ("import sys; sys.path.insert(0, '.'); import evil", "imported evil"),
    "a warning": ("import numpy; numpy.float64(1) / numpy.float64(0)", "foreign line"),
    "a library's line": ("import os; os.write(2, b'libpng error\\n')", "foreign line"),
    "an escape": ("print('\\x1b[2J')", "U+001B"),
}


@pytest.mark.parametrize("name", ATTACKS)
def test_what_a_process_does_is_seen(name: str, harness: Harness) -> None:
    code, expected = ATTACKS[name]
    case = replace(CASE, files={**CASE.files, "evil.py": b""})
    slack = 0.2 if name == "CPU" else 1.0  # of the five seconds that a command has
    told = violations(case, harness.run(case, instead=code), slack=slack)
    assert any(expected in line for line in told), told


def test_a_plain_failure_is_as_it_must_be_in_either_process(harness: Harness) -> None:
    for outcome in (harness.run(CASE), harness.run_fresh(CASE)):
        assert violations(CASE, outcome) == []
        assert outcome.code == 1
