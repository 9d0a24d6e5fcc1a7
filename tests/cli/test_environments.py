"""Commands where the environment lacks what most have: a home, a locale, names that are text."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.cli.main import run
from posetrack_cli.errors import EXIT_DONE, EXIT_FAILED, EXIT_USAGE
from posetrack_cli.evaluation.viewing.outputs import VideoFile
from support.hostile_files import write_depth, write_grey, write_hand_result

COMMAND = [sys.executable, "-m", "posetrack_cli.cli.main"]
KEPT = ("PATH", "PYTHONPATH", "VIRTUAL_ENV", "LD_LIBRARY_PATH")
ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
NOT_UTF8 = os.fsdecode(b"caf\xe9 \xff\x9b31m")
"""A name in Latin-1, with a control of its own."""


def command(
    arguments: list[str | Path], folder: Path, **environment: str
) -> subprocess.CompletedProcess[bytes]:
    """Run a command in an environment that has nothing but what is given."""
    bare = {name: os.environ[name] for name in KEPT if name in os.environ}
    return subprocess.run(
        [*COMMAND, *arguments], cwd=folder, env={**bare, **environment}, capture_output=True
    )


@pytest.mark.parametrize(
    "environment",
    [
        {"HOME": "/nonexistent", "TMPDIR": "/nonexistent", "LC_ALL": "xx_XX.UTF-8"},
        ASCII,
    ],
    ids=["no folders", "C"],
)
def test_files_are_read_and_written_without_home_locale_and_terminal(
    tmp_path: Path, environment: dict[str, str]
) -> None:
    """Also where a name is no text: it is shown some way, and the files are what they are elsewhere."""
    folder = tmp_path / NOT_UTF8
    folder.mkdir()
    write_depth(folder / NOT_UTF8)
    out = f"{NOT_UTF8}.mcap"
    done = command(["convert", NOT_UTF8, "-o", out], folder, **environment)
    assert (done.returncode, done.stderr) == (EXIT_DONE, b"")
    done.stdout.decode("ascii")
    assert os.fsencode(out) not in done.stdout and b"2 frames" in done.stdout
    expected = tmp_path / "expected.mcap"
    assert run(["convert", str(folder / NOT_UTF8), "-o", str(expected)]) == EXIT_DONE
    assert (folder / out).read_bytes() == expected.read_bytes()


def test_a_result_with_a_name_that_is_no_text_is_evaluated(tmp_path: Path) -> None:
    result = write_hand_result(tmp_path / f"{NOT_UTF8}.mcap")
    reports = ["--json", "r.json", "--csv", "r.csv", "--html", f"{NOT_UTF8}.html"]
    done = command(["eval", result.name, *reports], tmp_path, **ASCII)
    assert done.returncode == EXIT_DONE, done.stderr
    assert done.stderr.count(b"\n") == 1 and b"no pictures" in done.stderr
    assert json.loads((tmp_path / "r.json").read_bytes())["results"][0]["name"]
    for name in ("r.json", "r.csv", f"{NOT_UTF8}.html"):
        (tmp_path / name).read_text(encoding="utf-8")
    (done.stdout + done.stderr).decode("ascii")


def test_videos_have_names_that_are_no_text(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Of which OpenCV knows nothing but to crash."""
    video = VideoFile(tmp_path / f"{NOT_UTF8}.mp4", 30.0)
    for index in range(3):
        video.add(index, np.full((48, 64, 3), 80 * index, np.uint8))
    video.close()
    assert run(["info", str(tmp_path / f"{NOT_UTF8}.mp4")]) == EXIT_DONE
    assert "video" in capfd.readouterr().out
    noise = tmp_path / NOT_UTF8
    noise.write_bytes(b"noise")
    for arguments in (["info", noise], ["head", "mono", noise, "-o", tmp_path / "o.mcap"]):
        assert run(list(map(str, arguments))) == EXIT_FAILED
        assert capfd.readouterr().err.count("\n") == 1
    grey, out = write_grey(tmp_path / "grey"), tmp_path / "o.mcap"
    model = ["--detector", "yunet", "--detector-model", str(noise)]
    assert run(["head", "mono", str(grey), "-o", str(out), *model]) == EXIT_USAGE
    assert "not a YuNet model" in capfd.readouterr().err


def test_a_missing_file_whose_name_is_no_text_is_one_line(tmp_path: Path) -> None:
    done = command(["info", NOT_UTF8], tmp_path, **ASCII)
    assert done.returncode == EXIT_FAILED
    assert done.stderr.startswith(b"posetrack: caf\\udce9") and done.stderr.count(b"\n") == 1


def test_a_recording_is_drawn_without_home_and_locale(tmp_path: Path) -> None:
    """Which reads shaders, meshes and settings of ours."""
    arguments = ["hand", "synth", "--frames", "1", "--motion", "A", "-o", f"{NOT_UTF8}.mcap"]
    done = command(arguments, tmp_path, **ASCII)
    assert (done.returncode, done.stderr) == (EXIT_DONE, b"")
    assert (tmp_path / f"{NOT_UTF8}.mcap").is_file()
