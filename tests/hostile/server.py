"""A process that has imported everything, and runs every case in a child of its own.

As a program it reads requests, one JSON text a line, and answers each with one line. A child is the process
that a user would have started, but for the seconds of its start: it calls ``main()`` with the arguments in
``sys.argv``, in the case's folder, with files as standard output and error. It stands under limits that stop
what has gone wrong, and an audit hook tells what it opened to write, started, or looked for on the network.
"""

from __future__ import annotations

import faulthandler
import gc
import importlib
import json
import os
import pkgutil
import resource
import select
import signal
import sys
import time
import traceback
import warnings
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import Any
from unittest.mock import patch

from posetrack_cli.interpreter import module_command

GIB = 1 << 30
ADDRESS_BYTES = 6 * GIB
"""Of address space, beyond that of the idle process: threads and drivers reserve much that they never use."""
WALL_LIMIT_S = 900.0
SPAWNING = (
    "subprocess.Popen",
    "os.system",
    "os.fork",
    "os.forkpty",
    "os.exec",
    "os.posix_spawn",
    "pty.spawn",
)
REACHING = ("socket.connect", "socket.bind", "socket.getaddrinfo", "urllib.Request")
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
CHANGING = (
    "os.remove",
    "os.rename",
    "os.rmdir",
    "os.mkdir",
    "os.symlink",
    "os.link",
    "os.truncate",
    "os.chmod",
)


def serve() -> None:
    """Answer requests until there are none."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # whatever prints in this process must not be taken for an answer
    prepare()
    print(json.dumps({"ready": True}), file=answers, flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        answer = {"code": _warm(request["warm"])} if "warm" in request else run_child(request)
        print(json.dumps(answer), file=answers, flush=True)


def prepare() -> None:
    """Import everything; no thread may run when children are forked."""
    import cv2

    import posetrack_cli

    cv2.setNumThreads(0)
    for module in pkgutil.walk_packages(posetrack_cli.__path__, "posetrack_cli."):
        importlib.import_module(module.name)
    for name in (
        "av",
        "ezc3d",
        "ndx_pose",
        "pyarrow.parquet",
        "encodings.idna",
        "multiprocessing.util",
        "http.client",
        "numpy.lib.format",
        "importlib.resources",
    ):
        importlib.import_module(name)


def _warm(commands: list[list[str]]) -> list[int]:
    """Run commands in this process: its children have compiled code loaded. None may open a GL context.

    What they import later is not compiled to files: that would be writing where no command may.
    """
    sys.dont_write_bytecode = True
    from posetrack_cli.cli.main import run

    with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere):  # noqa: PTH123
        return [run(command) for command in commands]


def run_child(request: dict[str, Any]) -> dict[str, Any]:
    """Run a command line in a child and return what it was and did."""
    reading, writing = os.pipe()
    gc.freeze()  # else each child would copy every page of what is imported, only to find nothing to collect
    began = time.monotonic()
    child = os.fork()
    if child == 0:
        os.close(reading)
        _be_child(request, writing)
    os.close(writing)
    status, usage, ended = _wait(child, reading, began, request["blocked_s"], Path(request["stacks"]))
    with os.fdopen(reading, "rb") as stream:
        said = stream.read().splitlines()
    reports: list[dict[str, Any]] = [json.loads(line) for line in said]
    report = {key: value for entry in reports for key, value in entry.items()}
    code = os.waitstatus_to_exitcode(status)
    return {
        "code": code,
        "ended": ended,
        "cpu_s": usage.ru_utime + usage.ru_stime,
        "wall_s": time.monotonic() - began,
        "peak_bytes": usage.ru_maxrss * 1024 - report.get("idle_bytes", 0),
        "modules": report.get("modules", []),
        "events": report.get("events", []),
    }


def _wait(
    child: int, reading: int, began: float, blocked_s: float, stacks: Path
) -> tuple[int, resource.struct_rusage, str]:
    """Wait for a child; one that computes nothing for ``blocked_s`` is told to say where, and killed.

    Its end of the pipe is closed as it ends, which wakes this process: most cases take less than a nap.
    """
    computed, since = 0.0, began
    closed = select.poll()
    closed.register(reading, 0)  # for nothing but that the other end is closed
    while True:
        pid, status, usage = os.wait4(child, os.WNOHANG)
        if pid:
            return status, usage, ""
        now = time.monotonic()
        used = _cpu_seconds(child)
        if used > computed:
            computed, since = used, now
        if now - since > blocked_s or now - began > WALL_LIMIT_S:
            ended = "blocked" if now - since > blocked_s else "too long"
            with suppress(ProcessLookupError):
                os.kill(child, signal.SIGUSR1)
                time.sleep(0.2)
                os.kill(child, signal.SIGKILL)
            _, status, usage = os.wait4(child, 0)
            return status, usage, ended
        if closed.poll(20):
            time.sleep(0.0005)  # it is about to end, or closed it and goes on


def _cpu_seconds(child: int) -> float:
    with suppress(OSError, IndexError):
        fields = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return 0.0


def _be_child(request: dict[str, Any], report: int) -> None:
    """Run the command line as a process of its own would, and end this process."""
    code = 70
    try:
        _limit(request["cpu_s"])
        os.chdir(request["folder"])
        os.environ["TMPDIR"] = request["temporary"]
        _redirect(request)
        stacks = os.open(request["stacks"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        faulthandler.register(signal.SIGUSR1, stacks, all_threads=True)
        faulthandler.register(signal.SIGXCPU, stacks, all_threads=True, chain=True)
        faulthandler.enable(stacks)
        warnings.simplefilter("default", category=RuntimeWarning, append=True)  # forgets which were shown
        known = set(sys.modules)
        _say(report, {"idle_bytes": _resident_bytes()})
        events = _audited(request["folder"], request["temporary"])
        with _stopped_after(request.get("stop_after")):
            code = _called(["posetrack", *request["command"]], request["instead"])
        events.append("end")
        _say(report, {"modules": _foreign(set(sys.modules) - known), "events": events[:-1]})
    except BaseException:  # the harness's own mistakes must not look like the product's
        os.write(report, json.dumps({"events": [f"harness: {traceback.format_exc()}"]}).encode() + b"\n")
    finally:
        os._exit(code)


def _called(argv: list[str], instead: str) -> int:
    """Call ``main()``, or run some Python instead, and return the exit code, as the interpreter does it."""
    from posetrack_cli.cli import main as command

    sys.argv = argv
    code: Any = 0
    try:
        with patch.object(command, "fork_under_memory_limit"):  # who limits and watches this process does it
            exec(instead, {}) if instead else command.main()
    except SystemExit as error:
        code = error.code
        if code is None:
            code = 0
        elif not isinstance(code, int):
            print(code, file=sys.stderr)
            code = 1
    except BaseException:
        traceback.print_exc()
        code = 1
    for stream in (sys.stdout, sys.stderr):
        with suppress(Exception):
            stream.flush()
    return code & 0xFF


def _limit(cpu_s: int) -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + ADDRESS_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 2))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (GIB, GIB))


def _redirect(request: dict[str, Any]) -> None:
    """Standard streams as files, with the text layers that a fresh interpreter has."""
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    for number, name in ((1, "out"), (2, "error")):
        os.dup2(os.open(request[name], os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND, 0o600), number)
    sys.stdin = sys.__stdin__ = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stdout = sys.__stdout__ = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stderr = sys.__stderr__ = open(  # noqa: SIM115
        2, "w", buffering=1, encoding="utf-8", errors="backslashreplace", closefd=False
    )


def _audited(folder: str, temporary: str) -> list[str]:
    """Return a list that grows with what this process does and no recording may make it do, until "end"."""
    events: list[str] = []
    own = tuple(os.path.realpath(name) + os.sep for name in (folder, temporary, _cache()))

    def heard(event: str, arguments: tuple[Any, ...]) -> None:
        if events[-1:] == ["end"]:
            return
        if event in REACHING or (event in SPAWNING and not _is_own_process(arguments)):
            events.append(f"{event} {arguments!r}"[:500])
        elif (
            event == "open"
            and len(arguments) == 3
            and isinstance(arguments[2], int)
            and arguments[2] & WRITING
        ) or event in CHANGING:
            _check_written(events, event, arguments[0], own)

    sys.addaudithook(heard)
    return events


def _is_own_process(arguments: tuple[Any, ...]) -> bool:
    """Whether a process is what tries a detector's model, or what finds libGL for ``ctypes.util``."""
    if not arguments:
        return False
    is_trial = list(arguments[1:2]) == [module_command("posetrack_cli.head.detection.model_trial")]
    return is_trial or os.path.basename(str(arguments[0])) == "ldconfig"  # noqa: PTH119


def _check_written(events: list[str], event: str, path: Any, own: tuple[str, ...]) -> None:
    if isinstance(path, (str, bytes, os.PathLike)):
        whole = os.path.abspath(os.fsdecode(path))  # noqa: PTH100 links stay: what they lead to is compared later
        parent = os.path.realpath(os.path.dirname(whole)) + os.sep  # noqa: PTH120
        if not parent.startswith(own) and whole != os.devnull:
            events.append(f"{event} {whole}")


def _cache() -> str:
    """The folder in which posetrack keeps what it computes once."""
    from posetrack_cli.compiled import kernel_folder

    folder = kernel_folder()
    return os.devnull if folder is None else os.path.dirname(folder)  # noqa: PTH120


def _foreign(names: set[str]) -> list[str]:
    """Return the modules that are neither Python's, nor installed, nor the package's."""
    import posetrack_cli

    homes = {
        sys.prefix,
        sys.base_prefix,
        str(Path(posetrack_cli.__file__).parent),
        os.path.realpath(sys.base_prefix),
    }
    found = []
    for name in sorted(names):
        module = sys.modules.get(name)
        file = getattr(module, "__file__", None)
        builtin = getattr(getattr(module, "__spec__", None), "origin", None) in ("built-in", "frozen")
        if not builtin and not (file and file.startswith(tuple(homes))):
            found.append(name)
    return found


def _resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def _say(report: int, values: dict[str, Any]) -> None:
    os.write(report, json.dumps(values).encode()[:60_000] + b"\n")


@contextmanager
def _stopped_after(frames: int | None) -> Any:
    """Have a run believe that Ctrl-C came after so many frames: how seeds of interrupted runs are made."""
    if frames is None:
        yield
        return
    asked = iter(range(frames))

    @contextmanager
    def signals(*_: object) -> Any:
        yield lambda: next(asked, None) is None

    for name, module in list(sys.modules.items()):
        if name.startswith("posetrack_cli.cli.") and hasattr(module, "stop_signals"):
            module.stop_signals = signals  # type: ignore[attr-defined]
    yield


if __name__ == "__main__":
    serve()
