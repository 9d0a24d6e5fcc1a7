"""The way from any mistake to one line and an exit code, and what happens to an output nobody can read."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from posetrack_cli.build import source_digest, version
from posetrack_cli.cli.main import run

COMMAND = [sys.executable, "-m", "posetrack_cli.cli.main"]
SYNTH = ["hand", "synth", "--frames", "2", "--motion", "A"]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "r.mcap"
    assert run([*SYNTH, "-o", str(path)]) == 0
    return path


@pytest.mark.parametrize(
    ("arguments", "found", "help_of"),
    [
        (["hand", "run", "r", "-o", "r.mcap", "--particles", "0"], "'--particles'", "posetrack hand run"),
        (["hand", "run", "r", "-o", "r.mcap", "--filter", "x"], "'rbpf', 'pf'", "posetrack hand run"),
        (["hand", "run"], "Missing argument 'RECORDING'", "posetrack hand run"),
        (["convert", "a"], "Missing option '-o' / '--output'", "posetrack convert"),
        (["info", "a", "--jsn"], "--jsn", "posetrack info"),
        (["inof"], "No such command 'inof'", "posetrack"),
    ],
)
def test_wrong_usage_is_one_line(
    capsys: pytest.CaptureFixture[str], arguments: list[str], found: str, help_of: str
) -> None:
    assert run(arguments) == 2
    out, error = capsys.readouterr()
    assert out == "" and error.count("\n") == 1 and error.startswith("posetrack: ")
    assert found in error and error.endswith(f"; see: {help_of} --help\n")


@pytest.mark.parametrize(
    ("arguments", "former", "now"),
    [
        (["view", "r", "-o", "v.mp4", "--scale", "2"], "--scale", "--zoom"),
        (["view", "r", "-o", "v.mp4", "--frames=worst:3"], "--frames", "--select"),
        (["view", "r", "-o", "v.mp4", "--truth"], "--truth", "--show-truth"),
        (["eval", "r", "--layout", "rows"], "--layout", "--rows or --columns"),
        (["eval", "r", "--tolerance-ms", "1"], "--tolerance-ms", "--truth-tolerance-ms"),
        (["export", "r", "--topic", "t"], "--topic", "--estimate-topic"),
        (["hand", "calibrate", "r", "-o", "h.toml", "--frames", "8"], "--frames", "--fit-frames"),
        (["head", "build-model", "r", "-o", "m", "--identity", "3"], "--identity", "--identity-size"),
        (["head", "synth", "-o", "h", "--cameras", "1"], "--cameras", "--camera-count"),
        (["head", "synth", "-o", "h", "--noise", "2"], "--noise", "--noise-factor"),
        (["head", "synth", "-o", "h", "--distortion"], "--distortion", "--lens-distortion"),
        (["head", "synth", "-o", "h", "--baseline", "60"], "--baseline", "--baseline-mm"),
    ],
    ids=lambda value: value if isinstance(value, str) else " ",
)
def test_a_former_name_is_told_with_the_new_one(
    capsys: pytest.CaptureFixture[str], arguments: list[str], former: str, now: str
) -> None:
    assert run(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"posetrack: {former} was renamed to {now}; see: ") and error.count("\n") == 1


def test_without_a_command_it_helps(capsys: pytest.CaptureFixture[str]) -> None:
    assert run([]) == 2
    assert "Commands:" in capsys.readouterr().err


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no full device here")
@pytest.mark.parametrize("command", [["info"], ["info", "--json", "-"], ["--help"]], ids=" ".join)
def test_a_full_output_is_one_line(recording: Path, command: list[str]) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([*COMMAND, *command, str(recording)], stdout=full, stderr=subprocess.PIPE)
    assert (done.returncode, done.stderr.decode()) == (1, "posetrack: output: No space left on device\n")


def test_a_reader_that_has_gone_is_no_error_to_tell(recording: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run([*COMMAND, "info", str(recording)], stdout=writing, stderr=subprocess.PIPE)
    os.close(writing)
    assert (done.returncode, done.stderr) == (1, b"")


def test_a_name_that_the_terminal_cannot_show_is_shown_some_way(recording: Path, tmp_path: Path) -> None:
    name = "\N{HIRAGANA LETTER A}.mcap"
    (tmp_path / name).write_bytes(recording.read_bytes())
    environment = os.environ | {"PYTHONIOENCODING": "latin-1"}
    arguments = [*COMMAND, "info", str(tmp_path / name)]
    done = subprocess.run(arguments, env=environment, capture_output=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(b"\\u3042.mcap: MCAP")


def test_help_leaves_out_what_is_rare(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert run(["hand", "run", "--help"]) == 0
    usual = capsys.readouterr().out
    assert "--help-all" in usual and "--depth-unit-mm" not in usual and len(usual.splitlines()) <= 60
    assert run(["hand", "run", "--help-all"]) == 0
    whole = capsys.readouterr().out
    names = {word for word in whole.split() if word.startswith("--")}
    assert "--depth-unit-mm" in names and {word for word in usual.split() if word.startswith("--")} < names


def test_the_package_runs_as_a_module() -> None:
    line = [sys.executable, "-m", "posetrack_cli", "--version"]
    done = subprocess.run(line, capture_output=True, text=True, check=True)
    assert done.stdout == f"posetrack, version {version()} (sources {source_digest()})\n"
