"""Ctrl-C and SIGTERM while kernels are compiled, which may take a minute: nothing waits for that."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from posetrack_cli.cli.process import terminate_as_interrupted
from posetrack_cli.errors import EXIT_INTERRUPTED
from posetrack_cli.outputs import part_path, state_path

COMPILING = """
import ctypes, pathlib, signal, sys, time
import click
from numba.core.event import trigger_event
from posetrack_cli.cli.running import announce_compiling
from posetrack_cli.cli.main import cli, main
from posetrack_cli.cli.process import stop_signals
from posetrack_cli.cli.terminal import print_note

def kernel(kind):
    with trigger_event("numba:compile"):
        if kind == "library":
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})  # which would wake it up
        print("compiling", flush=True)
        if kind == "library":
            ctypes.CDLL(None).sleep(60)
        time.sleep(60)

@cli.command()
@click.argument("kind")
@click.argument("out", type=pathlib.Path)
def compile(kind, out):
    if kind == "none":
        print("compiling", flush=True)
        time.sleep(60)
    with announce_compiling(out) as is_compiling:
        if kind == "before":
            kernel(kind)
        with stop_signals(is_compiling) as stopped:
            try:
                if kind == "later":
                    print("compiling", flush=True)
                    while not stopped():
                        time.sleep(0.01)
                    time.sleep(0.1)
                kernel(kind)
            except KeyboardInterrupt:
                assert stopped()
                print_note("the usual line")
                click.get_current_context().exit(130)

cli.add_command(compile)
main()
"""
USUAL = "the usual line\n"
LATEST_S = 30.0
"""Half of what the made-up compiler takes: a machine with much to do is no error."""


def interrupted(kind: str, out: Path, number: signal.Signals = signal.SIGTERM) -> str:
    """What a command says that is interrupted while it compiles."""
    with subprocess.Popen(
        [sys.executable, "-c", COMPILING, "compile", kind, str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        line = process.stdout.readline()
        while line and line != "compiling\n":
            line = process.stdout.readline()
        if kind == "library":
            time.sleep(0.5)  # until it is in there, and Python handles no signal
        began = time.monotonic()
        os.kill(process.pid, number)
        said = process.stderr.read()
    assert process.returncode == EXIT_INTERRUPTED, said
    assert time.monotonic() - began < LATEST_S
    return said.removeprefix("compiling kernels: about 30 s of CPU time, cached for later runs ...\n")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_compiling_is_left_at_once(tmp_path: Path, number: signal.Signals) -> None:
    assert interrupted("frame", tmp_path / "r.mcap", number) == USUAL


def test_before_a_run_there_is_nothing_to_keep(tmp_path: Path) -> None:
    assert interrupted("before", tmp_path / "r.mcap") == "posetrack: interrupted\n"


def test_nothing_is_compiled_any_more_once_it_is_to_stop(tmp_path: Path) -> None:
    assert interrupted("later", tmp_path / "r.mcap") == USUAL


def test_a_library_that_returns_to_nobody_is_left_too(tmp_path: Path) -> None:
    out = tmp_path / "r.mcap"
    part_path(out).touch()
    state_path(out).touch()
    assert interrupted("library", out) == (
        f"interrupted during compilation: {part_path(out)}; continue with --resume\n"
    )


def test_a_command_without_kernels_is_terminated_as_interrupted(tmp_path: Path) -> None:
    assert interrupted("none", tmp_path / "r.mcap") == "posetrack: interrupted\n"


@pytest.mark.parametrize(
    ("handler", "expected"), [(signal.SIG_IGN, signal.SIG_IGN), (signal.SIG_DFL, signal.default_int_handler)]
)
def test_a_signal_that_is_to_be_ignored_stays_so(handler: signal.Handlers, expected: object) -> None:
    before = signal.signal(signal.SIGTERM, handler)
    try:
        terminate_as_interrupted()
        assert signal.getsignal(signal.SIGTERM) == expected
    finally:
        signal.signal(signal.SIGTERM, before)
