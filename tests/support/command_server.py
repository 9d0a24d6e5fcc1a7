"""The command ``posetrack`` for scripts of tests, without the second that each process takes to start.

A process that has imported everything and loaded compiled code waits for the command lines that a small
program called ``posetrack`` hands over, with its folder and its standard streams, and runs each in a child of
its own: ``main()`` with these arguments, as the installed command does it.
"""

from __future__ import annotations

import importlib
import json
import os
import signal
import socket
import subprocess
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from hostile.server import prepare

REQUEST_BYTES = 1 << 16
WARM = "--warm"
TIMEOUT_S = 600.0
"""Where nothing is compiled yet, and much else is done beside."""
OWN = ("POSETRACK_", "_POSETRACK_")
"""How the variables begin that a command reads, and that are handed over."""
ON_DEMAND = ("scipy.interpolate", "scipy.optimize", "scipy.stats")
"""What commands import only where they need it; here each would do so anew."""
BROKEN = 70
"""Exit code of a command whose process crashed."""

_CLIENT = """#!{python} -IS
import json, os, socket, sys
with socket.socket(socket.AF_UNIX) as line:
    line.connect({socket!r})
    told = {{name: value for name, value in os.environ.items() if name.startswith({own!r})}}
    socket.send_fds(line, [json.dumps([sys.argv[1:], os.getcwd(), told]).encode()], [0, 1, 2])
    said = line.recv(1)
sys.exit(said[0] if said else {broken})
"""


Warm = Callable[[Sequence[Sequence[str]]], None]


@contextmanager
def served_command(path: Path) -> Iterator[Warm]:
    """Serve a command while the context lasts.

    Args:
        path: of the command; its folder must exist.

    Yields:
        What runs command lines in the serving process: its children have the compiled code that they loaded.
        None of them may draw, as the threads of a GL context do not live on in children.
    """
    address = path.with_name("socket")
    path.write_text(
        _CLIENT.format(python=sys.executable, socket=str(address), own=OWN, broken=BROKEN), encoding="utf-8"
    )
    path.chmod(0o755)
    tests = Path(__file__).parents[1]
    server = subprocess.Popen(
        [sys.executable, "-m", "support.command_server", str(address)],
        cwd=path.parent,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(tests), str(tests.parent)])},
        stdout=subprocess.PIPE,
        text=True,
    )

    def warm(commands: Sequence[Sequence[str]]) -> None:
        for arguments in commands:
            subprocess.run([path, WARM, *arguments], check=True, capture_output=True, timeout=TIMEOUT_S)

    try:
        assert server.stdout is not None
        assert server.stdout.readline() == "ready\n"
        yield warm
    finally:
        server.kill()
        server.communicate()


def serve(address: str) -> None:
    """Run command lines, side by side, until this process is ended."""
    prepare()
    for name in ON_DEMAND:
        importlib.import_module(name)
    from posetrack_cli.cli.main import run

    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for the children
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(address)
        listening.listen()
        print("ready", flush=True)
        while True:
            line, _ = listening.accept()
            request, streams, _, _ = socket.recv_fds(line, REQUEST_BYTES, 3)
            arguments, folder, told = json.loads(request)
            if arguments[:1] == [WARM]:
                line.send(bytes([run(arguments[1:])]))
            elif os.fork() == 0:
                listening.close()
                os.environ.update(told)
                _answer(line, arguments, folder, streams)
            for stream in (line.detach(), *streams):
                os.close(stream)


def _answer(line: socket.socket, arguments: Sequence[str], folder: str, streams: Sequence[int]) -> None:
    """Be the process of a command line, and tell its exit code."""
    code = BROKEN
    try:
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        os.chdir(folder)
        for number, stream in enumerate(streams):
            os.dup2(stream, number)
            os.close(stream)
        code = _main(arguments)
    finally:
        with suppress(OSError):
            line.send(bytes([code]))
        os._exit(code)


def _main(arguments: Sequence[str]) -> int:
    from posetrack_cli.cli.main import main

    sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", buffering=1, encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.argv = ["posetrack", *arguments]
    code: Any = 0
    try:
        main()
    except SystemExit as error:
        code = error.code
    except BaseException:
        traceback.print_exc()
        code = BROKEN
    for stream in (sys.stdout, sys.stderr):
        with suppress(Exception):
            stream.flush()
    return int(code or 0) & 0xFF


if __name__ == "__main__":
    serve(sys.argv[1])
