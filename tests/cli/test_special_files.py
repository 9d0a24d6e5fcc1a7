"""Pipes, sockets, devices and folders in the place of input files: one line, and nothing is waited for."""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

import pytest

from posetrack_cli.cli.main import run
from posetrack_cli.errors import EXIT_DATA_LOST, EXIT_DONE, EXIT_FAILED, EXIT_USAGE
from support.hostile_files import write_depth, write_grey, write_hand_result

LIMIT_S = 60
"""After which nobody waits any more; each takes a second at most."""
X, DEPTH, GREY, RESULT = "x", "depth", "grey", "result.mcap"
HAND = ["hand", "run", DEPTH, "-o", "o.mcap"]
MONO = ["head", "mono", GREY, "-o", "o.mcap"]
COMMANDS = [
    ["info", X],
    ["eval", X],
    ["eval", "--group", f"a={X}", "--group", f"b={RESULT}"],
    *(["eval", RESULT, option, X] for option in ("--truth", "--recording", "--baseline", "--gates")),
    ["export", X],
    ["convert", X, "-o", "o.mcap"],
    *(["convert", DEPTH, "-o", "o.mcap", option, X] for option in ("--truth", "--camera")),
    ["view", X, "-o", "o.png"],
    ["view", RESULT, "-o", "o.png", "--recording", X],
    ["hand", "run", X, "-o", "o.mcap"],
    *([*HAND, option, X] for option in ("--camera", "--config", "--init", "--hand-mesh")),
    ["hand", "calibrate", X, "-o", "o.toml"],
    ["head", "stereo", X, "-o", "o.mcap"],
    ["head", "mono", X, "-o", "o.mcap"],
    *([*MONO, option, X] for option in ("--camera", "--config", "--init", "--load-model", "--face-model")),
    [*MONO, "--detector", "yunet", "--detector-model", X],
    ["head", "build-model", X, "-o", "o.npz"],
    ["calibrate", "stereo", X, "-o", "o.toml", "--squares", "4x3", "--square-mm", "9"],
]
KINDS = ["pipe", "socket", "device", "folder", "link to a pipe", "nothing"]


def put(path: Path, kind: str) -> None:
    """Put something of a kind in the place of a file."""
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as bound:
            bound.bind(path.name)  # relative: such names are short
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "folder":
        path.mkdir()
    elif kind == "link to a pipe":
        os.mkfifo(path.with_name("pipe"))
        path.symlink_to("pipe")


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("inputs")
    write_depth(folder / DEPTH)
    write_grey(folder / GREY)
    write_hand_result(folder / RESULT)
    return folder


@pytest.fixture
def folder(tmp_path: Path, inputs: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with inputs of every command."""
    shutil.copytree(inputs, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(autouse=True)
def limited() -> Iterator[None]:
    def too_long(number: int, frame: FrameType | None) -> None:
        raise AssertionError("waited for what never comes")

    before = signal.signal(signal.SIGALRM, too_long)
    signal.alarm(LIMIT_S)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def one_line(capsys: pytest.CaptureFixture[str]) -> str:
    told = capsys.readouterr().err
    assert told.startswith("posetrack: ") and told.count("\n") == 1, told
    return told


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("arguments", COMMANDS, ids=lambda value: " ".join(value))
def test_what_is_no_file_is_one_line(
    folder: Path, arguments: list[str], kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    put(folder / X, kind)
    before = sorted(folder.rglob("*"))
    assert run(arguments) in (EXIT_FAILED, EXIT_USAGE)
    assert re.search(rf"\b{X}\b", one_line(capsys))
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
@pytest.mark.parametrize("name", ["camera.toml", "timestamps.csv", "0.png", "1.png"])
def test_nothing_in_a_folder_is_waited_for(
    folder: Path, name: str, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """An image that is none is left out; what else a folder needs is told."""
    for recording, command in ((DEPTH, ["convert", DEPTH, "-o", "o.mcap"]), (GREY, [*MONO, "--passes", "1"])):
        (folder / recording / name).unlink()
        put(folder / recording / name, kind)
        assert run(["info", recording]) in (EXIT_DONE, EXIT_DATA_LOST, EXIT_FAILED)
        capsys.readouterr()
        if recording == DEPTH or not name.endswith(".png"):
            assert run(command) in (EXIT_FAILED, EXIT_USAGE, EXIT_DATA_LOST)
            assert capsys.readouterr().err.count("\n") == 1
