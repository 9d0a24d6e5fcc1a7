"""The process around a command: closed streams, what libraries print, bugs, memory."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import click
import pytest

from posetrack_cli.cli import main
from posetrack_cli.cli.main import cli, run
from posetrack_cli.errors import EXIT_DONE, EXIT_FAILED
from support.results import write_result

COMMAND = [sys.executable, "-m", "posetrack_cli.cli.main"]
CLOSINGS = ["2>&-", ">&-", "<&- >&- 2>&-"]
NOISE = """
import click, ctypes, logging, os, sys, warnings
from posetrack_cli.cli.main import cli, main

@cli.command()
@click.argument("crash", required=False)
def noise(crash):
    os.write(2, b"libpng warning: from C\\n")
    warnings.warn("invalid value", RuntimeWarning)
    logging.getLogger("library").warning("logged")
    sys.stderr.write("ours\\n")
    if crash:
        ctypes.string_at(0)

cli.add_command(noise)
main()
"""


def noise(*arguments: str, python: tuple[str, ...] = (), **environment: str) -> subprocess.CompletedProcess:
    """A command that calls libraries which print."""
    command = [sys.executable, *python, "-c", NOISE, "noise", *arguments]
    without = {key: value for key, value in os.environ.items() if key not in ("PYTHONWARNINGS",)}
    return subprocess.run(command, env=without | environment, capture_output=True, text=True)


@pytest.mark.parametrize("closed", CLOSINGS)
def test_closed_streams_change_neither_files_nor_exit_codes(closed: str, tmp_path: Path) -> None:
    """What is said does not end in the file that took the closed stream's number."""
    result, out, expected = write_result(tmp_path / "r.mcap", 3), tmp_path / "out.csv", tmp_path / "e.csv"
    line = f'"$0" "$@" {closed}'
    arguments = ["export", str(result), "-o"]
    done = subprocess.run(["sh", "-c", line, *COMMAND, *arguments, str(out)], capture_output=True, text=True)
    assert done.returncode == EXIT_DONE and done.stderr == ""
    assert run([*arguments, str(expected)]) == EXIT_DONE
    assert out.read_bytes() == expected.read_bytes()


@pytest.mark.parametrize("closed", CLOSINGS)
def test_closed_streams_change_no_error(closed: str) -> None:
    done = subprocess.run(
        ["sh", "-c", f'"$0" "$@" {closed}', *COMMAND, "info", "no"], capture_output=True, text=True
    )
    told = "" if "2>&-" in closed else "posetrack: no: no such file or folder\n"
    assert (done.returncode, done.stderr) == (EXIT_FAILED, told)


def test_libraries_say_nothing_on_standard_error() -> None:
    done = noise()
    assert (done.returncode, done.stderr) == (EXIT_DONE, "ours\n")


def test_debugging_shows_what_libraries_say() -> None:
    told = noise(POSETRACK_DEBUG="1").stderr
    for line in ("libpng warning: from C", "RuntimeWarning: invalid value", "logged", "ours"):
        assert line in told


def test_warnings_that_were_asked_for_are_shown() -> None:
    assert "RuntimeWarning: invalid value" in noise(python=("-Wdefault",)).stderr
    told = noise(PYTHONWARNINGS="default").stderr
    assert "RuntimeWarning: invalid value" in told
    assert "libpng" not in told and "logged" not in told


def test_a_crash_in_a_library_tells_where() -> None:
    done = noise("crash")
    assert done.returncode < 0
    assert "Segmentation fault" in done.stderr and "in noise" in done.stderr


def failing(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    """The command ``fail`` raises an error."""

    @click.command()
    def fail() -> None:
        raise error

    monkeypatch.setitem(cli.commands, "fail", fail)


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (KeyError("x"), "KeyError: 'x'"),
        (ValueError("two\nlines \x1b[2J"), "ValueError: two lines \\x1b[2J"),
        (RecursionError("maximum recursion depth exceeded"), "RecursionError: maximum"),
        (AssertionError(), "AssertionError at"),
        (RuntimeError("long " * 1000), "RuntimeError: long"),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Exception) else "",
)
def test_a_bug_is_one_line(
    error: Exception, told: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    failing(monkeypatch, error)
    assert run(["fail"]) == EXIT_FAILED
    line = capsys.readouterr().err
    assert line.startswith(f"posetrack: internal error: {told}") and line.count("\n") == 1
    assert "at posetrack_cli/cli/main.py:" in line and "this is a bug" in line
    assert len(line) < 500


def test_a_bug_is_told_at_the_innermost_line_of_ours(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("posetrack_cli.recording.opening._source_of", lambda path: {}[path])
    assert run(["info", __file__]) == EXIT_FAILED
    assert "at posetrack_cli/recording/opening.py:" in capsys.readouterr().err


def test_a_traceback_only_for_debugging(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    failing(monkeypatch, KeyError("x"))
    for debugging, shown in (("", False), ("0", False), ("1", True)):
        monkeypatch.setenv("POSETRACK_DEBUG", debugging)
        assert run(["fail"]) == EXIT_FAILED
        told = capsys.readouterr().err
        assert ("Traceback" in told) is shown
        assert told.splitlines()[-1].startswith("posetrack: internal error: ")


def test_memory_that_is_not_there_is_one_line_that_fits_every_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    failing(monkeypatch, MemoryError("Unable to allocate 3.2 GiB"))
    assert run(["fail"]) == EXIT_FAILED
    line = capsys.readouterr().err
    assert line.startswith("posetrack: out of memory (Unable to allocate 3.2 GiB); ")
    assert "smaller images" in line and line.count("\n") == 1


def test_run_leaves_the_process_alone() -> None:
    """Streams and signals are a program's own; only ``main`` changes them."""
    before = sys.stdout, sys.stderr, os.fstat(2)
    assert main.run(["--version"]) == EXIT_DONE
    assert (sys.stdout, sys.stderr, os.fstat(2)) == before


PRODUCT = """
import os
import sys
from posetrack_cli.cli.main import main
from posetrack_cli.cli.process import prepare_process

assert "numpy" not in sys.modules
prepare_process()
import numpy

numpy.ones((500, 500)) @ numpy.ones((500, 500))
print(len(os.listdir("/proc/self/task")))
"""


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="counts threads as Linux tells them")
def test_products_are_rounded_alike_on_any_number_of_cores() -> None:
    """BLAS starts no threads of its own, though it was asked to."""
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "4"}
    done = subprocess.run([sys.executable, "-c", PRODUCT], env=environment, capture_output=True, text=True)
    assert done.stdout.split() == ["1"], done.stderr


LIMITED = """
import os, resource, signal, sys
from posetrack_cli.cli.main import main
from posetrack_cli.cli import main as module
which, size, end = getattr(resource, sys.argv[1]), int(sys.argv[2]), sys.argv[3]
resource.setrlimit(which, (size, resource.getrlimit(which)[1]))
def run(arguments):
    if end == "thread":
        raise RuntimeError("can't start new thread")
    os.abort() if end == "abort" else os._exit(int(end))
if end == "thread":
    module.cli.main = lambda **options: run(())
elif end != "command":
    module.run = run
sys.argv[1:] = ["info", "gone.mcap"]
main()
"""


def limited(which: str, size: int, end: str) -> subprocess.CompletedProcess[str]:
    """A command under a limit of memory that ends in some way."""
    line = [sys.executable, "-c", LIMITED, which, str(size), end]
    return subprocess.run(line, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(("which", "letter"), [("RLIMIT_AS", "v"), ("RLIMIT_DATA", "d")])
def test_a_limit_of_memory_that_libraries_do_not_survive_is_refused(which: str, letter: str) -> None:
    done = limited(which, 500 << 20, "command")
    assert done.returncode == 2
    assert done.stderr.startswith(f"posetrack: memory limit is too low (ulimit -{letter}), found 512000 KiB")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(("end", "code"), [("0", 0), ("3", 3), ("130", 130), ("abort", 1)])
def test_a_library_that_aborts_for_want_of_memory_is_one_line(end: str, code: int) -> None:
    done = limited("RLIMIT_AS", 4 << 30, end)
    assert done.returncode == code
    words = "posetrack: a library aborted, probably out of memory (ulimit -v); raise the limit\n"
    assert done.stderr == (words if end == "abort" else "")


def test_threads_that_cannot_start_are_one_line() -> None:
    done = limited("RLIMIT_AS", 4 << 30, "thread")
    assert done.returncode == 1
    assert done.stderr.startswith("posetrack: out of memory or threads: raise ulimit -v or -u")
    assert done.stderr.count("\n") == 1
