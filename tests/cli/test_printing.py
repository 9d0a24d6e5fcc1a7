"""What files say reaches a terminal without what it would obey; programs get it as it is."""

from __future__ import annotations

import ast
import json
import os
import pty
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from posetrack_cli.cli.main import run
from posetrack_cli.errors import EXIT_DONE
from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.results import ResultWriter
from posetrack_cli.text import printable
from support import results as results_support
from support.eval_command import write_result

CLI = Path(__file__).parents[2] / "posetrack_cli" / "cli"
HOSTILE = "\x1b]0;owned\x07\x1b[2J\x9b31m\x7f\u202e\nposetrack: done"
ESCAPED = "\\x1b]0;owned\\x07\\x1b[2J\\x9b31m\\x7f\\u202e\\nposetrack: done"
MARKUP = "[bold red]x[/bold red] [link=http://example.org]:smile:[/link]"


@pytest.mark.parametrize("path", sorted(CLI.glob("*.py")), ids=lambda path: path.name)
def test_commands_print_only_what_is_printable(path: Path) -> None:
    """Nothing but ``terminal`` writes to the standard streams; errors and bars have no way around."""
    names = [ast.unparse(node.func) for node in ast.walk(ast.parse(path.read_text())) if is_call(node)]
    others = {"click.echo", "click.secho", "print", "sys.stdout.write", "sys.stderr.write"}
    assert path.name == "terminal.py" or not others & set(names)


def is_call(node: ast.AST) -> bool:
    return isinstance(node, ast.Call)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Every name and value in it is hostile."""
    path = tmp_path / "r.mcap"
    with McapSink(path) as sink:
        channel = sink.channel(f"/{HOSTILE}", RawImage)
        sink.metadata(HOSTILE, {HOSTILE: HOSTILE})
        sink.metadata("posetrack.run", {HOSTILE: HOSTILE})
        sink.attachment(HOSTILE, HOSTILE, b"")
        image = RawImage(width=1, height=1, encoding="16UC1", step=2, data=bytes(2), frame_id=HOSTILE)
        sink.write(channel, 1, image.SerializeToString())
        sink.finish()
    return path


def test_info_of_a_hostile_file_is_lines_of_text(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["info", str(recording)]) == EXIT_DONE
    out, error = capsys.readouterr()
    assert ESCAPED in out and error == ""
    assert printable(out) == out
    assert not any(line.startswith("posetrack:") for line in out.splitlines())


def test_json_of_a_hostile_file_says_the_same_in_escapes(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["info", str(recording), "--json", "-"]) == EXIT_DONE
    out = capsys.readouterr().out
    assert printable(out) == out
    values = json.loads(out)
    assert values["topics"][0]["topic"] == f"/{HOSTILE}"
    assert values["attachments"][0]["name"] == HOSTILE


@pytest.mark.parametrize("name", [HOSTILE.replace("/", ""), MARKUP], ids=["controls", "markup"])
def test_tables_show_hostile_names_as_they_are_spelt(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = name.replace("/", "_")
    paths = [str(write_result(tmp_path / f"{name}{number}.mcap", 30, seed=number)) for number in (1, 2)]
    assert run(["eval", *paths]) == EXIT_DONE
    out = capsys.readouterr().out
    shown = printable(name).replace("\n", "\\n")
    assert f"{shown}1" in out and f"{shown}2" in out
    assert printable(out) == out


def hostile_result(tmp_path: Path) -> Path:
    """A result whose joints have hostile names."""
    path = tmp_path / "h.mcap"
    names = (HOSTILE, *results_support.SUBJECT.point_names[1:])
    subject = replace(results_support.SUBJECT, point_names=names)
    with ResultWriter(path, subject, results_support.CAMERA, results_support.RUN) as writer:
        writer.write(results_support.make_estimate(0))
        writer.finish({})
    return path


def test_a_table_has_no_control_characters(tmp_path: Path) -> None:
    path = hostile_result(tmp_path)
    command = [sys.executable, "-m", "posetrack_cli.cli.main", "export", str(path), "--format", "csv"]
    piped = subprocess.run(command, capture_output=True)
    assert piped.returncode == EXIT_DONE, piped.stderr
    assert b"\\x1b]0;owned" in piped.stdout and b"\x1b" not in piped.stdout
    reading, writing = pty.openpty()
    with subprocess.Popen(command, stdout=writing, stderr=subprocess.PIPE) as started:
        os.close(writing)
        shown = b""
        while piece := terminal_output(reading):
            shown += piece
    os.close(reading)
    assert started.returncode == EXIT_DONE
    assert b"\\x1b]0;owned" in shown and b"\x1b" not in shown


def terminal_output(descriptor: int) -> bytes:
    try:
        return os.read(descriptor, 65536)
    except OSError:  # how a terminal says that nobody writes any more
        return b""


def test_a_json_export_means_the_same_without_controls(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["export", str(hostile_result(tmp_path)), "--format", "json"]) == EXIT_DONE
    out = capsys.readouterr().out
    assert printable(out) == out
    assert any(name.startswith(HOSTILE) for name in json.loads(out)["columns"])
