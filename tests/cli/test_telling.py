"""How much commands say, what they say can be typed next, and what a shell completes."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from posetrack_cli.cli.main import cli, run
from posetrack_cli.cli.running import Listener, next_of_result, print_next, use_listener
from support.markdown import check

SYNTH = ["hand", "synth", "--frames", "2", "--motion", "A"]


def said(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[list[str], list[str]]:
    assert run(list(arguments)) == 0
    out, error = capsys.readouterr()
    return out.splitlines(), error.splitlines()


def test_quiet_says_nothing_and_verbose_more(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    usual, nothing = said(capsys, *SYNTH, "-o", str(path))
    assert len(usual) == 2 and nothing == []
    assert said(capsys, *SYNTH, "-o", str(path), "--overwrite", "-q") == ([], [])
    _, details = said(capsys, *SYNTH, "-o", str(path), "--overwrite", "-v")
    assert details[-1].startswith("took ") and details[-1].endswith(" s CPU time")
    assert len(said(capsys, *SYNTH, "-o", str(path), "--overwrite")[0]) == 2  # each command anew


def test_quiet_is_not_silent_about_what_went_wrong(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert run(["convert", str(tmp_path / "none"), "-o", str(tmp_path / "r.mcap"), "--quiet"]) == 1
    assert "no such file or folder" in capsys.readouterr().err


def test_quiet_and_verbose_exclude_each_other(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert run([*SYNTH, "-o", str(tmp_path / "r.mcap"), "-q", "-v"]) == 2
    assert "--quiet and --verbose are mutually exclusive" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["it's here", "-dash", "a;b $(c) *"])
def test_what_is_next_can_be_typed(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    result, recording = Path(f"{name}.mcap"), tmp_path / "rec.mcap"
    print_next(*next_of_result(recording, result))
    lines = capsys.readouterr().out.splitlines()
    words = [shlex.split(line.removeprefix("next: posetrack ")) for line in lines]
    assert [one[0] for one in words] == ["eval", "view"]
    for one in words:
        check(one)  # no path is taken for an option
        assert Path(one[1]) == result


def test_what_is_next_replaces_nothing_unasked(tmp_path: Path) -> None:
    """A recording beside the result is found, and keeps its name; an earlier report is to be overwritten."""
    recording, result = tmp_path / "face.mp4", tmp_path / "face.mcap"
    for path in (recording, tmp_path / "face.html"):
        path.touch()
    report, video = next_of_result(recording, result)
    assert report[-1] == "--overwrite"
    assert "--recording" not in video and video[-1] == tmp_path / "face-tracked.mp4"


def test_names_that_no_terminal_shows_are_not_suggested(capsys: pytest.CaptureFixture[str]) -> None:
    print_next(("info", Path("a\x1b[2Jb.mcap")))
    assert capsys.readouterr().out == ""


def test_a_batch_suggests_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    class Elsewhere(Listener):
        is_alone = False

    with use_listener(Elsewhere()):
        print_next(("info", Path("a.mcap")))
    assert capsys.readouterr().out == ""


def completed(line: str, folder: Path) -> list[str]:
    """What bash is told, types and values."""
    words = line.split(" ")
    environment = os.environ | {
        "_POSETRACK_COMPLETE": "bash_complete",
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(words) - 1),
    }
    command = [sys.executable, "-m", "posetrack_cli.cli.main"]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.split()


def test_a_shell_completes_commands_options_values_and_files(tmp_path: Path) -> None:
    assert {"plain,hand", "plain,head"} <= set(completed("posetrack h", tmp_path))
    assert completed("posetrack view a.mcap --sel", tmp_path) == ["plain,--select"]
    assert completed("posetrack hand run a.mcap --hand-side r", tmp_path) == ["plain,right"]
    assert completed("posetrack hand run re", tmp_path) == ["file,re"]
    assert completed("posetrack hand run a.mcap --shape av", tmp_path) == ["plain,average"]
    assert completed("posetrack hand run a.mcap --shape my", tmp_path) == ["file,my"]


def test_every_command_that_runs_can_be_quiet() -> None:
    instant = {"info", "doctor"}
    missing = {
        name
        for name, one in cli.commands.items()
        if not hasattr(one, "commands") and "-q" not in [called for p in one.params for called in p.opts]
    }
    assert missing == instant
