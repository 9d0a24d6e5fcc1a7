"""Progress bars: what a screen shows of them and of lines meanwhile; a pipe gets only the lines."""

from __future__ import annotations

import fcntl
import io
import os
import pty
import re
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from threading import Thread
from types import SimpleNamespace

import pytest

from posetrack_cli.batch.engine import JobProgress
from posetrack_cli.batch.jobs import Outcome, State
from posetrack_cli.cli.batch_commands import BatchProgress
from posetrack_cli.cli.running import progress
from posetrack_cli.cli.terminal import (
    QUIET,
    bar,
    print_line,
    print_note,
    show_on_bar,
    show_phase,
    volume,
)
from posetrack_cli.errors import EXIT_INTERRUPTED
from posetrack_cli.phases import phase, phases_shown
from support.terminal import Terminal, screen


def opened_terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """A terminal that shows both streams, as it usually does."""
    shown = Terminal()
    monkeypatch.setattr(sys, "stderr", shown)
    monkeypatch.setattr(sys, "stdout", shown)
    return shown


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time in seconds that bars take it to be."""
    now = [0.0]
    monkeypatch.setattr("tqdm.std.time", lambda: now[0])
    return now


def frames(clock: list[float], count: int, of: int, seconds: float) -> Iterator[SimpleNamespace]:
    """The last frames of a pass, each of which takes so long."""
    for index in range(of - count, of):
        clock[0] += seconds
        yield SimpleNamespace(frame_index=index, effective_sample_size=None, status="tracking")


def test_lines_go_above_the_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = opened_terminal(monkeypatch)
    with bar("hand", "frame", 4) as shown:
        print_note("before")
        assert terminal.lines[0] == "before" and terminal.lines[1].startswith("hand:   0%|")
        shown.advance(2, "tracking")
        print_line("of the answer")
        print_note("x" * 100)
        shown.advance(2, "lost")
    print_note("after")
    *above, last, after = terminal.lines
    assert above == ["before", "of the answer", "x" * 80, "x" * 20] and after == "after"
    assert re.fullmatch(r"hand: 100%\|.*\| 4/4 \[.*frame/s, lost\]", last)


def test_two_passes_stand_below_each_other_each_with_its_own_time(
    monkeypatch: pytest.MonkeyPatch, clock: list[float]
) -> None:
    terminal = opened_terminal(monkeypatch)
    with ExitStack() as stack:
        first, second = [stack.enter_context(progress(10, 0, 1, name)) for name in ("pass 1", "pass 2")]
        assert len(terminal.lines) == 1
        for frame in frames(clock, 10, 10, seconds=2.0):
            first(frame)
        print_note("between")
        for frame in frames(clock, 10, 10, seconds=0.5):
            second(frame)
    between, one, two = terminal.lines
    # from its first report to that of the second pass: 18.5 s
    assert re.fullmatch(r"pass 1: 100%\|.*\| 10/10 \[00:18<00:00,  1.85s/frame, tracking\]", one), one
    assert between == "between"
    assert re.fullmatch(r"pass 2: 100%\|.*\| 10/10 \[00:04<00:00,  2.22frame/s, tracking\]", two), two


def test_frames_before_this_run_took_it_no_time(monkeypatch: pytest.MonkeyPatch, clock: list[float]) -> None:
    terminal = opened_terminal(monkeypatch)
    with progress(100, 0, 1, "hand") as report:
        for frame in frames(clock, 20, 80, seconds=0.5):
            report(frame)
    (shown,) = terminal.lines
    # the first frame's time is not seen, as its report begins the bar: 19 in 9.5 s, and as many are missing
    assert re.search(r" 80/100 \[00:09<00:09,  2\.\d\dframe/s", shown), shown


def test_a_bar_that_does_not_stay_leaves_an_empty_line(
    monkeypatch: pytest.MonkeyPatch, clock: list[float]
) -> None:
    terminal = opened_terminal(monkeypatch)
    with bar("eval", "result", 2, stays=False) as shown:
        clock[0] += 1.0  # bars are not drawn more often than anybody looks
        shown.advance()
        assert terminal.lines[0].startswith("eval:  50%|")
    assert terminal.lines == [""]


def test_a_bar_grows_no_wider_than_a_terminal_that_states_no_size(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = opened_terminal(monkeypatch)
    with bar("x" * 100, "frame", 3) as shown:
        shown.advance(1, "y" * 100)
    assert terminal.lines == ["x" * 77]


def test_a_bar_is_drawn_though_it_grows_slow_or_only_its_note_changes(
    monkeypatch: pytest.MonkeyPatch, clock: list[float]
) -> None:
    terminal = opened_terminal(monkeypatch)
    with bar("hand", "frame", 2000) as shown:
        for _ in range(1000):
            clock[0] += 0.001
            shown.advance()
        for step, note in ((1, "slow"), (0, "changed")):
            clock[0] += 1.0
            shown.advance(step, note)
            assert " 1001/2000 [" in terminal.lines[0] and terminal.lines[0].endswith(f", {note}]")


def test_an_unknown_total_may_be_given_later(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = opened_terminal(monkeypatch)
    with bar("board", "image") as shown:
        shown.advance()
        assert terminal.lines[0].startswith("board: ")
        shown.advance(total=4)
    assert terminal.lines[0].startswith("board:  50%|") and " 2/4 [" in terminal.lines[0]


def test_what_files_say_reaches_no_terminal_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = opened_terminal(monkeypatch)
    with bar("hand", "frame", 3) as shown:
        shown.advance(3, "a\x1b[2J\nb")
    assert terminal.lines[0].endswith(r", a\x1b[2J\nb]")


@pytest.mark.parametrize("quiet", [False, True])
def test_a_pipe_and_quiet_get_lines_only(quiet: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = Terminal() if quiet else io.StringIO()
    monkeypatch.setattr(sys, "stderr", shown)
    with (
        volume(QUIET) if quiet else ExitStack(),
        bar("hand", "frame", 2) as one,
        progress(2, 0, 1, "b") as two,
    ):
        assert not one.is_drawn
        one.advance(2, "note")
        two(SimpleNamespace(frame_index=1, effective_sample_size=7.0, status="lost"))
        print_note("what went wrong")
    assert shown.getvalue() == "what went wrong\n" and one.done == 2


def counted(advance: Callable[[int], None]) -> None:
    advance(2)
    print_note("a line")
    advance(1)


def test_a_phase_is_a_bar_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = opened_terminal(monkeypatch)
    with phases_shown(show_phase):
        for total in (3, None):
            with phase("finding", "frame", total) as advance:
                counted(advance)
    line, known, again, open_ended = terminal.lines
    assert line == again == "a line"
    assert re.fullmatch(r"finding: 100%\|.*\| 3/3 \[.*\]", known), known
    assert re.fullmatch(r"finding: 3frame \[.*\]", open_ended), open_ended


@pytest.mark.parametrize(("quiet", "said"), [(False, "finding ...\na line\n"), (True, "a line\n")])
def test_a_phase_is_a_line_in_a_pipe_and_nothing_for_quiet(
    quiet: bool, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = io.StringIO()
    monkeypatch.setattr(sys, "stderr", shown)
    with ExitStack() as stack:
        stack.enter_context(volume(QUIET) if quiet else ExitStack())
        stack.enter_context(phases_shown(show_phase))
        counted(stack.enter_context(phase("finding", "frame", 3)))
    assert shown.getvalue() == said


def test_a_phase_that_nobody_shows_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with phase("finding", "frame") as advance:
        advance(1)
    assert capsys.readouterr() == ("", "")


def test_the_time_of_a_bar_goes_on_while_its_count_stands_still(
    monkeypatch: pytest.MonkeyPatch, clock: list[float]
) -> None:
    monkeypatch.setattr("posetrack_cli.cli.terminal._REDRAWN_EVERY_S", 0.02)
    terminal = opened_terminal(monkeypatch)
    with bar("hand", "frame", 4) as shown:
        shown.advance()
        clock[0] = 83.0
        until_s = time.monotonic() + 5.0
        while "[01:23" not in terminal.lines[0] and time.monotonic() < until_s:
            time.sleep(0.02)
        assert " 1/4 [01:23" in terminal.lines[0]
    left = terminal.lines
    clock[0] = 99.0
    time.sleep(0.1)
    assert terminal.lines == left  # one that is over stays as it was


def test_what_is_said_meanwhile_stands_on_the_bar_until_it_advances(
    monkeypatch: pytest.MonkeyPatch, clock: list[float]
) -> None:
    show_on_bar("of no bar")
    terminal = opened_terminal(monkeypatch)
    with bar("hand", "frame", 4) as shown:
        shown.advance(1, "tracking")
        show_on_bar("compiling kernel 7")
        assert terminal.lines[0].endswith(", compiling kernel 7]")
        clock[0] += 1.0
        shown.advance()
        assert terminal.lines[0].endswith(", tracking]")


def test_lines_of_several_workers_break_no_bar_of_a_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = opened_terminal(monkeypatch)
    names = [f"{worker}-{job}" for worker in "abcd" for job in range(25)]

    def work(worker: str) -> None:
        for job in range(25):
            name = f"{worker}-{job}"
            shown.on_progress(JobProgress(name, "hand", 5, 10))
            shown.note(f"{name}: noted")
            shown.on_outcome(Outcome(name, State.FAILED, "as it must"))

    with BatchProgress(len(names)) as shown:
        threads = [Thread(target=work, args=(worker,)) for worker in "abcd"]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    *lines, last = terminal.lines
    failed = [f"{name}: failed: as it must" for name in names]
    assert sorted(line.partition("] ")[2] or line for line in lines) == sorted(
        [*failed, *(f"{name}: noted" for name in names)]
    )
    assert re.fullmatch(r"batch: 100%\|.*\| 100/100 \[.*, 100 failed, 0 frame.*", last), last


WAITING = """
import ctypes, fcntl, signal, termios, time
import click
from numba.core.event import trigger_event
from posetrack_cli.cli.main import cli, main
from posetrack_cli.cli.terminal import bar
from posetrack_cli.cli.running import announce_compiling
from posetrack_cli.cli.terminal import print_note

@cli.command()
@click.argument("where")
def wait(where):
    with announce_compiling(), bar("hand", "frame", 4) as shown:
        shown.advance(2, "tracking")
        print_note("waiting")
        if where == "python":
            time.sleep(60)
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # which would wake the library up
        with trigger_event("numba:compile"):
            ctypes.CDLL(None).sleep(60)

cli.add_command(wait)
fcntl.ioctl(0, termios.TIOCSCTTY)
main()
"""


@pytest.mark.parametrize("where", ["python", "library"])
def test_ctrl_c_leaves_a_clean_terminal(where: str) -> None:
    """The bar's last state, with the ^C that terminals echo on its line, and the closing line below."""
    own, its = pty.openpty()
    fcntl.ioctl(its, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    with subprocess.Popen(
        [sys.executable, "-c", WAITING, "wait", where],
        stdin=its,
        stdout=its,
        stderr=its,
        start_new_session=True,
    ) as process:
        os.close(its)
        written = until(own, rb"50%.*\]" if where == "python" else rb"(?s)compiling.*50%.*\]")
        time.sleep(0.3)  # until it is in the library
        os.write(own, b"\x03")
        written += until(own)
    os.close(own)
    assert process.returncode == EXIT_INTERRUPTED
    *above, shown, last = screen(written.decode().replace("\r\n", "\n"))
    assert last == "posetrack: interrupted"
    note = "tracking" if where == "python" else "compiling kernel 1"
    assert re.fullmatch(rf"hand:  50%\|.*\| 2/4 \[.*, {note}\]\^C", shown), shown
    told = ["waiting", "compiling kernels: about 30 s of CPU time, cached for later runs ..."]
    assert above == told[: 1 if where == "python" else 2]


def until(terminal: int, pattern: bytes = rb"\Z.") -> bytes:
    """Read until something is written, or until nobody writes any more."""
    written = b""
    with suppress(OSError):  # which Linux raises at the end
        while not re.search(pattern, written):
            written += os.read(terminal, 4096)
    return written
